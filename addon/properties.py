"""The artist's settings, kept in the scene as ``scene.prt``."""

from pathlib import Path

import bpy

from . import cache_folder
from .atlas_files import Target
from .prt.job import ALL, Settings

VERIFY_POINTS = 256  # of each object, traced again by brute force: enough to tell 1 % from 1.1 %


class PRT_PG_settings(bpy.types.PropertyGroup):
    """How finely to bake."""

    order: bpy.props.IntProperty(
        name="Order",
        description="Detail of the light: 3 holds soft light and skies, 5 holds sharper shadows "
        "and takes more memory",
        default=3,
        min=2,
        max=5,
        options=set(),
    )
    quality: bpy.props.EnumProperty(
        name="Quality by",
        description="What decides how many rays are traced",
        items=(
            ("RAYS", "Rays", "The same number of rays from every point"),
            ("TOLERANCE", "Error", "As many rays as the noise that you allow takes"),
        ),
        default="RAYS",
        options=set(),
    )
    tolerance: bpy.props.FloatProperty(
        name="Error",
        description="Noise that may be left: half of it takes three times as long",
        default=1.0,
        min=0.1,
        max=50.0,
        soft_min=0.5,
        soft_max=10.0,
        precision=1,
        subtype="PERCENTAGE",
        options=set(),
    )
    residual: bpy.props.BoolProperty(
        name="Exact at This World",
        description="Bake what the order leaves out too, so that the sharp shadows of this very "
        "world are there; they fade as you turn it away",
        default=True,
        options=set(),
    )
    turns: bpy.props.IntProperty(
        name="Turns",
        description="Exact at this many turns of the world about Z, for turntables: 12 keep sharp "
        "shadows all the way round, and take 9 vertex attributes more",
        default=1,
        min=1,
        max=24,
        options=set(),
    )
    peaks: bpy.props.IntProperty(
        name="Peaks",
        description="How many suns and lamps of the HDRI may be cut out of it and keep shadows of "
        "their own, where that is worth it; a glTF viewer can light them itself",
        default=0,
        min=0,
        max=4,
        options=set(),
    )
    final_light: bpy.props.BoolProperty(
        name="Final Light",
        description="This world will not be exchanged: what it does not show is not stored",
        default=False,
        options=set(),
    )
    bounces: bpy.props.IntProperty(
        name="Bounces",
        description="How often light goes on from surface to surface, with its colour: 0 is "
        "shadows alone, 3 holds most of it. Coloured surfaces take three times the attributes",
        default=0,
        min=0,
        max=64,
        soft_max=8,
        options=set(),
    )
    all_bounces: bpy.props.BoolProperty(
        name="All Bounces",
        description="Go on until what a bounce adds is too little to see",
        default=False,
        options=set(),
    )
    keep_direct: bpy.props.BoolProperty(
        name="Keep Direct Light",
        description="Keep the light without bounces too, for glTF: then a viewer can switch off "
        "what they add. EEVEE shows all of it as before",
        default=False,
        options=set(),
    )
    visibility_order: bpy.props.EnumProperty(
        name="Occlusion of Reflections",
        description="Bake what each point sees, so that reflections grow dark where something "
        "stands before them",
        items=(
            ("0", "None", "Reflections shine through whatever stands before them"),
            ("2", "Order 2", "Which side is open: takes about 1 vertex attribute"),
            ("3", "Order 3", "Good for rough surfaces: takes 2 or 3 vertex attributes"),
            ("4", "Order 4", "Finer: takes 4 vertex attributes"),
            ("5", "Order 5", "Finest: takes 6 or 7 vertex attributes"),
        ),
        default="0",
        options=set(),
    )
    reflections: bpy.props.BoolProperty(
        name="Reflections",
        description="Shiny and metallic Principled materials reflect the world, turned and "
        "swapped as you like; off, they keep EEVEE's own look where they are metal, and shine not "
        "at all where they are not",
        default=False,
        options=set(),
    )
    rays: bpy.props.IntProperty(
        name="Rays",
        description="Rays traced from every point: three times as many halve the noise",
        default=256,
        min=16,
        max=65536,
        soft_min=64,
        soft_max=4096,
        options=set(),
    )
    gltf_short: bpy.props.BoolProperty(
        name="16-bit Bakes",
        description="Write bakes as 16-bit numbers: half the size, and off by at most 1/65534 of "
        "each number's largest value on the mesh",
        default=False,
        options=set(),
    )
    gltf_compress: bpy.props.BoolProperty(
        name="Compressed Bakes",
        description="Write bakes on vertices as clusters of principal components: a fraction of "
        "the size, within the error below. A bake that this makes no smaller has 16 bits a number",
        default=False,
        options=set(),
    )
    gltf_error: bpy.props.FloatProperty(
        name="Error",
        description="How far the compressed light may be off, relative to all light: the smallest "
        "that keeps to it is written",
        default=1.0,
        min=0.1,
        max=50.0,
        soft_max=10.0,
        precision=1,
        subtype="PERCENTAGE",
        options=set(),
    )
    gltf_ibl: bpy.props.BoolProperty(
        name="Light for Other Viewers",
        description="Write the world as an image-based light, so that a viewer that does not know "
        "bakes lights the plain materials by it: Babylon.js does. About 1 MB",
        default=False,
        options=set(),
    )
    carrier: bpy.props.EnumProperty(
        name="Bake To",
        description="Where the bake is kept",
        items=(
            ("VERTEX", "Vertices", "In vertex attributes: small, and as fine as the mesh"),
            ("TEXTURE", "Texture", "In a texture with a UV map of its own: as fine as you like"),
            ("AUTO", "Automatic", "For each object what is less wrong for its memory"),
        ),
        default="VERTEX",
        options=set(),
    )
    size_by: bpy.props.EnumProperty(
        name="Size by",
        description="What decides how large a texture is",
        items=(
            ("RESOLUTION", "Resolution", "As large as you say"),
            ("DENSITY", "Density", "As large as so many texels a metre take"),
        ),
        default="RESOLUTION",
        options=set(),
    )
    resolution: bpy.props.EnumProperty(
        name="Resolution",
        description="Texels along a texture's side: twice as many show shadows half as small, and "
        "take four times the memory and about three times as long",
        items=tuple((str(n), f"{n} x {n}", "") for n in (256, 512, 1024, 2048, 4096)),
        default="1024",
        options=set(),
    )
    texel_density: bpy.props.FloatProperty(
        name="Texels a Metre",
        description="How fine a texture is; it becomes the next power of two that holds that",
        default=100.0,
        min=0.01,
        max=1e5,
        soft_min=1.0,
        soft_max=1000.0,
        options=set(),
    )
    shared_atlas: bpy.props.BoolProperty(
        name="One for All",
        description="All objects of a bake share one texture; else each has its own, but for those "
        "that share materials",
        default=True,
        options=set(),
    )
    padding_mip: bpy.props.IntProperty(
        name="Apart to Mip",
        description="Up to which mip level, at which the texture is seen from far away, its pieces "
        "stay apart: each level more doubles the gaps",
        default=2,
        min=0,
        max=6,
        options=set(),
    )
    half: bpy.props.BoolProperty(
        name="Half Floats",
        description="Store half floats: files half as large, off by 0.1 % at most",
        default=False,
        options=set(),
    )
    engine_images: bpy.props.EnumProperty(
        name="For Engines",
        description="Write each texture once more beside it, for programs that read no tiles: an "
        "image for every four numbers of a texel",
        items=(
            ("NONE", "None", "Blender's own image alone"),
            ("EXR", "EXR", "Images of floats"),
            ("PNG", "16-bit PNG", "For programs that read no EXR, with scales in a .json"),
        ),
        default="NONE",
        options=set(),
    )
    image_folder: bpy.props.StringProperty(
        name="Folder",
        description="Where textures are saved; // is the folder of the .blend",
        default="//",
        subtype="DIR_PATH",
        options=set(),
    )
    pack_images: bpy.props.BoolProperty(
        name="Pack into the .blend",
        description="Keep textures inside the .blend; one that is not saved yet always does",
        default=False,
        options=set(),
    )
    seed: bpy.props.IntProperty(
        name="Seed",
        description="Another seed gives other noise; the same seed gives the same bake",
        default=0,
        min=0,
        options=set(),
    )
    threads: bpy.props.IntProperty(
        name="Threads",
        description="Processor cores to bake on, 0 for all of them; changes nothing but the time",
        default=0,
        min=0,
        max=1024,
        soft_max=64,
        options=set(),
    )


def settings(scene: bpy.types.Scene, verify: bool = False) -> Settings:
    """What the artist chose, as a bake wants it; ``verify`` measures its error too."""
    chosen = scene.prt
    return Settings(
        order=chosen.order,
        rays=chosen.rays,
        tolerance=chosen.tolerance / 100 if chosen.quality == "TOLERANCE" else 0.0,
        residual=chosen.residual,
        turns=chosen.turns,
        peaks=chosen.peaks,
        final_light=chosen.final_light,
        resolution=int(chosen.resolution),
        texel_density=chosen.texel_density if chosen.size_by == "DENSITY" else 0.0,
        shared_atlas=chosen.shared_atlas,
        padding_mip=chosen.padding_mip,
        half=chosen.half,
        engine_images={"EXR": "exr", "PNG": "png"}.get(chosen.engine_images, ""),
        reflections=chosen.reflections,
        bounces=ALL if chosen.all_bounces else chosen.bounces,
        keep_direct=chosen.keep_direct,
        visibility_order=int(chosen.visibility_order) * chosen.reflections,
        cache=cache_folder.path(),
        seed=chosen.seed,
        threads=chosen.threads,
        verify_points=VERIFY_POINTS if verify else 0,
    )


def target(scene: bpy.types.Scene) -> Target:
    """Where the artist wants the bake."""
    chosen, saved = scene.prt, bpy.data.filepath
    folder = None
    if saved and not chosen.pack_images:
        folder = Path(bpy.path.abspath(chosen.image_folder or "//"))
    stem = Path(saved).stem if saved else "Untitled"
    return Target(chosen.carrier.lower(), folder, stem)


def register() -> None:
    """Give every scene its settings."""
    bpy.utils.register_class(PRT_PG_settings)
    bpy.types.Scene.prt = bpy.props.PointerProperty(type=PRT_PG_settings, name="PRT Baker")


def unregister() -> None:
    """Take them away."""
    del bpy.types.Scene.prt
    bpy.utils.unregister_class(PRT_PG_settings)
