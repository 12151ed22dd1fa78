"""A ball in Babylon.js, in the browser of the viewer's tests, lit by the light of its file."""

from pathlib import Path

PACKAGES = Path(__file__).parent / "node_modules"

# Two switches of Babylon.js': see docs/gltf.md. The middle of the ball faces the camera, so what it
# reflects comes from there. Babylon's own axes are left-handed, x of the file being -x there.
LOOK = """
    const add = async (buffer) => {
      const script = document.createElement('script');
      script.src = URL.createObjectURL(new Blob([buffer], { type: 'text/javascript' }));
      document.head.append(script);
      await new Promise((done, failed) => Object.assign(script, { onload: done, onerror: failed }));
    };
    if (!window.BABYLON) for (const file of [files.babylon, files.loaders]) await add(file);
    const SIZE = 33;
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = SIZE;
    const engine = new BABYLON.Engine(canvas, false);
    const scene = new BABYLON.Scene(engine);
    scene.imageProcessingConfiguration.applyByPostProcess = true;
    await BABYLON.SceneLoader.AppendAsync('', URL.createObjectURL(new Blob([files.glb])), scene, undefined, '.glb');
    const light = scene.environmentTexture;
    const found = { isCube: light.isCube, size: light.getSize().width, gamma: light.gammaSpace };
    light.gammaSpace = false;
    light.linearSpecularLOD = true;
    const camera = new BABYLON.FreeCamera('camera', BABYLON.Vector3.Zero(), scene);
    camera.fov = 0.05;
    const target = new BABYLON.RenderTargetTexture('target', SIZE, scene, {
      type: BABYLON.Constants.TEXTURETYPE_FLOAT, generateMipMaps: false,
    });
    Object.assign(target, { activeCamera: camera, renderList: scene.meshes });
    const [material] = scene.materials;
    const looks = { rough: [1, 0.25], diffuse: [0, 1] };
    for (const [name, [metallic, roughness]] of Object.entries(looks)) {
      Object.assign(material, { metallic, roughness, metallicF0Factor: metallic, albedoColor: BABYLON.Color3.White() });
      found[name] = [];
      for (const [x, y, z] of DIRECTIONS) {
        camera.position.set(-40 * x, 40 * y, 40 * z);
        camera.upVector = Math.abs(y) > 0.9 ? BABYLON.Vector3.Forward() : BABYLON.Vector3.Up();
        camera.setTarget(BABYLON.Vector3.Zero());
        await scene.whenReadyAsync();
        scene.render();
        target.render();
        const pixels = await target.readPixels();
        const middle = 2 * SIZE * SIZE - 2;
        found[name].push(Array.from(pixels.slice(middle, middle + 3)));
      }
    }
    scene.dispose();
    engine.dispose();
    return found;
"""  # noqa: E501


def seen_by_babylon(page, glb, directions):
    """What the ball of ``glb`` shows towards each of ``directions``, in the file's axes: as
    metal of roughness 0.25, and white and dull."""
    return page.run(
        LOOK.replace("DIRECTIONS", str(directions.tolist())),
        glb=glb,
        babylon=PACKAGES / "babylonjs" / "babylon.js",
        loaders=PACKAGES / "babylonjs-loaders" / "babylonjs.loaders.min.js",
    )
