"""How long the viewer draws."""

FRAMES = """
    const { stage } = viewer, times = { baked: [], plain: [] };
    const said = await stage.loadModel(files.glb);
    if (said.problems.length) throw new Error(said.problems.join());
    stage.resize(960, 540);
    const gl = stage.renderer.getContext(), pixel = new Uint8Array(4);
    const draw = (view) => {
      stage.show(view);
      const start = performance.now();
      stage.render();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);  // waits for it
      return performance.now() - start;
    };
    for (const view of ['baked', 'plain']) draw(view);  // compiles
    for (let i = 0; i < COUNT; ++i) {
      for (const view of ['baked', 'plain']) times[view].push(draw(view));
    }
    stage.show('baked');  // as it was
    const median = (values) => values.sort((a, b) => a - b)[values.length >> 1];
    return [median(times.baked), median(times.plain)];
"""


def frame_times(page, glb, count):
    """Milliseconds of a frame of the bakes of ``glb`` at 960 x 540, and of the same meshes with
    three.js' MeshStandardMaterial and an environment: medians of ``count``, taking turns."""
    return page.run(FRAMES.replace("COUNT", str(count)), glb=glb)
