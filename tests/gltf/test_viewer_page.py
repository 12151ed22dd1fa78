"""The viewer's page: files dropped on it, its controls, what it says."""

import pytest
from gltf_scenes import monkey
from gltf_worlds import bundled
from prt_baker.addon import gltf_export, gltf_panel
from viewer_frames import frame_times

HELPERS = """
    const $ = (selector) => document.querySelector(selector);
    const until = async (holds) => {
      for (let i = 0; i < 600 && !holds(); ++i) await new Promise((done) => setTimeout(done, 50));
      return holds();
    };
    const drop = (...given) => {
      const dataTransfer = new DataTransfer();
      for (const [name, data] of given) dataTransfer.items.add(new File([data], name));
      dispatchEvent(new DragEvent('dragover', { dataTransfer, cancelable: true }));
      dispatchEvent(new DragEvent('drop', { dataTransfer, cancelable: true }));
    };
    const set = (id, value) => {
      const input = $(`#${id}`);
      if (input.type === 'checkbox') input.checked = value; else input.value = value;
      input.dispatchEvent(new Event(input.type === 'checkbox' ? 'change' : 'input'));
    };
    const { stage } = viewer;
"""


@pytest.fixture
def file(scene, bake, out):
    """A baked monkey."""
    bake(monkey(), turns=1)
    gltf_export.write(str(out))
    return out


def test_a_model_and_an_environment_are_dropped_together(page, file):
    body = """
        drop(['sky.exr', files.sky], ['monkey.glb', files.glb]);
        await until(() => stage.picture && $('#sky').textContent === 'sky.exr');
        const texts = ['#name', '#facts', '#sky', '#message'].map((id) => $(id).textContent);
        const shown = [!$('#panel').hidden, !$('#drop').classList.contains('shown')];
        $('#reset').click();
        return { texts, shown, after: $('#sky').textContent, picture: stage.picture };
    """
    found = page.run(HELPERS + body, glb=file, sky=bundled("forest"))
    assert found["texts"] == [
        "monkey.glb",
        "1 bake, 968 triangles, 3 attributes each",
        "sky.exr",
        "",
    ]
    assert found["shown"] == [True, True]
    assert (found["after"], found["picture"]) == ("the file's", None)


def test_the_controls_do_what_they_say(page, file):
    body = """
        await viewer.open('monkey.glb', files.glb);
        set('environment', 77);
        set('model', 40);
        const turns = { ...stage.turns };
        const outputs = [...document.querySelectorAll('output')].map((one) => one.value);
        for (const id of ['albedo', 'residual', 'background']) set(id, false);
        const options = { ...stage.options };
        for (const id of ['albedo', 'residual', 'background']) set(id, true);
        set('exposure', 1);
        const exposure = stage.renderer.toneMappingExposure;
        set('exposure', 0);
        const views = [];
        for (const view of ['plain', 'error', 'baked']) {
          $(`input[value=${view}]`).click();
          views.push([stage.view, $('#legend').hidden]);
        }
        return { turns, outputs, options, exposure, views, lights: $('#lights').disabled };
    """
    found = page.run(HELPERS + body, glb=file)
    assert found["turns"] == {"environment": 77, "model": 40}
    assert found["outputs"][:2] == ["77°", "40°"]
    assert found["options"] == {
        "albedo": False,
        "bounces": True,
        "residual": False,
        "lights": True,
        "background": False,
    }
    assert found["exposure"] == 2
    assert found["views"] == [["plain", True], ["error", False], ["baked", True]]
    assert found["lights"], "nothing was cut out"


def test_the_error_view_is_dark_where_both_agree_and_bright_where_not(page, file):
    """Where the bake is the same as plain: nowhere, but the empty part of the picture."""
    body = """
        await viewer.open('monkey.glb', files.glb);
        stage.resize(48, 48);
        stage.set({ background: false });
        stage.show('error');
        const pixels = stage.readBytes();
        stage.show('baked');
        const middle = 4 * (24 * 48 + 24);
        return [Array.from(pixels.slice(0, 3)), Array.from(pixels.slice(middle, middle + 3))];
    """
    corner, middle = page.run(HELPERS + body, glb=file)
    assert corner == [5, 5, 13]
    assert sum(middle) > 60


def test_what_cannot_be_shown_is_said(page, file, tmp_path):
    (tmp_path / "bad.glb").write_bytes(b"glTF no more")
    body = """
        drop(['bad.glb', files.bad]);
        await until(() => $('#message').textContent);
        const first = $('#message').textContent;
        drop(['notes.txt', files.bad]);
        await until(() => $('#message').textContent !== first);
        return [first, $('#message').textContent];
    """
    first, second = page.run(HELPERS + body, bad=tmp_path / "bad.glb")
    assert first.startswith("bad.glb: it cannot be read (")
    assert "neither .glb, .hdr nor .exr" in second


def test_it_says_how_fast_it_draws(page, file):
    body = """
        const frame = document.createElement('iframe');
        frame.src = './';
        frame.style.width = frame.style.height = '64px';
        document.body.append(frame);
        const rate = () => frame.contentDocument?.querySelector('#rate')?.textContent;
        await until(rate);
        const text = rate();
        frame.remove();
        return text;
    """
    assert "frames/s" in page.run(HELPERS + body)


@pytest.mark.parametrize("error", [None, 0.02], ids=["floats", "clusters"])
@pytest.mark.usefixtures("registered")
def test_a_frame_takes_no_longer_than_with_a_standard_material(scene, bake, out, page, error):
    obj = monkey()
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 3
    bake(obj, turns=1, by_modifier=True, smooth=True, bent=True)
    with gltf_panel.chosen(scene, None, error):
        gltf_export.write(str(out))
    baked, standard = frame_times(page, out, 5)
    print(f"{baked:.0f} ms, standard material {standard:.0f} ms")
    assert baked <= standard
