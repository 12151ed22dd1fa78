"""The options of the command line, the same in Blender and in ``prt-bake``.  Needs no Blender."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from .prt.errors import BakeError
from .prt.job import ALL

SMALLEST_ERROR, LARGEST_ERROR = 0.001, 0.5


@dataclass(frozen=True)
class Options:
    """What was asked for; None where the .blend's own setting holds.

    ``blend`` is None inside Blender, which has opened the file itself.
    """

    blend: Path | None
    objects: list[str]
    carrier: str | None
    resolution: int | None
    texel_density: float | None
    shared_atlas: bool | None
    half: bool | None
    engine_images: str | None
    images: Path | None
    pack: bool | None
    order: int | None
    rays: int | None
    tolerance: float | None
    residual: bool | None
    turns: int | None
    peaks: int | None
    final_light: bool | None
    bounces: int | None
    keep_direct: bool | None
    reflections: bool | None
    visibility_order: int | None
    cache: bool
    seed: int | None
    threads: int | None
    world: str | None
    save: Path | None
    gltf: Path | None
    gltf_short: bool | None
    gltf_error: float | None
    gltf_ibl: bool | None
    report: Path | None
    verify: bool

    @property
    def outputs(self) -> list[Path]:
        """The files to write."""
        return [path for path in (self.save, self.gltf, self.report) if path is not None]


def parse(program: str, arguments: list[str], with_blend: bool) -> Options:
    """Read ``arguments``; BakeError says what is wrong with them."""
    found = _parser(program, with_blend).parse_args(arguments)
    for option, suffix in (("save", ".blend"), ("gltf", ".glb"), ("report", ".json")):
        path = getattr(found, option)
        if path is not None and path.suffix.lower() != suffix and not path.is_dir():
            raise BakeError(f"--{option} writes {suffix}: {path} needs that ending")
    return Options(
        blend=found.blend if with_blend else None,
        **{name: getattr(found, name) for name in Options.__dataclass_fields__ if name != "blend"},
    )


class _Parser(argparse.ArgumentParser):
    """A parser that says what is wrong in one sentence, without the usage."""

    def error(self, message: str) -> NoReturn:
        raise BakeError(f"{message} (see --help)")


def _parser(program: str, with_blend: bool) -> _Parser:
    parser = _Parser(
        prog=program,
        description="Bake shadowed light that follows the HDRI into the meshes of a .blend.  "
        "What is not given is as set in the .blend's sidebar.",
        epilog="Exit codes: 0 done, 1 a fault of the baker, 2 something you can mend, "
        "130 interrupted.",
        allow_abbrev=False,
    )
    if with_blend:
        parser.add_argument("blend", type=Path, metavar="SCENE.blend", help="what to bake")
    _add_what(parser)
    _add_how(parser)
    _add_where(parser)
    return parser


def _add_what(parser: _Parser) -> None:
    parser.add_argument(
        "--object",
        action="append",
        default=[],
        dest="objects",
        metavar="NAME",
        help="what to bake, again for more; default: what is selected, else every visible mesh",
    )
    parser.add_argument("--world", metavar="FILE.exr|.hdr", help="another HDRI for the scene")


def _add_how(parser: _Parser) -> None:
    add = parser.add_argument
    carriers = ("vertex", "texture", "auto")
    add("--carrier", choices=carriers, help="where to; auto: the smaller that is good enough")
    _add_textures(parser)
    add("--order", type=_whole(2, 5), metavar="N", help="bands of the light, 2 to 5")
    add(
        "--bounces",
        type=_bounces,
        metavar="K|all",
        help="of light from surface to surface, 0: shadows only; all: until nothing is left",
    )
    add(
        "--keep-direct",
        action=argparse.BooleanOptionalAction,
        help="with bounces, what there is without them too, for a viewer to leave them out",
    )
    add(
        "--visibility-order",
        type=_visibility_order,
        metavar="N",
        help="bands of what each point sees, for the occlusion of reflections: 2 to 5, 0: none",
    )
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--rays", type=_whole(16, 65536), metavar="N", help="rays a point")
    effort.add_argument(
        "--tolerance", type=_share, metavar="E", help="as many as leave this noise: 0.01 or 1%%"
    )
    add(
        "--reflections",
        action=argparse.BooleanOptionalAction,
        help="let shiny materials reflect the world",
    )
    _add_exact(parser)
    add("--seed", type=_whole(0, 2**31 - 1), metavar="N", help="same seed, same result")
    add("--threads", type=_whole(0, 1024), metavar="N", help="0: every core")
    add("--no-cache", action="store_false", dest="cache", help="trace all again, keep nothing")


def _add_textures(parser: _Parser) -> None:
    """How large textures are, and where they go."""
    add, size = parser.add_argument, parser.add_mutually_exclusive_group()
    size.add_argument("--resolution", type=_side, metavar="N", help="texels along a texture's side")
    size.add_argument("--texel-density", type=_positive, metavar="D", help="texels a metre instead")
    add(
        "--own-textures",
        action="store_const",
        const=False,
        dest="shared_atlas",
        help="one for each object, or for those that share materials; default: one for all",
    )
    add("--half", action="store_const", const=True, help="half floats: smaller files, 0.1%% off")
    add(
        "--engine-images",
        choices=("exr", "png"),
        help="textures once more for engines, an image for every four numbers; png: of 16 bits",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--images",
        type=Path,
        metavar="FOLDER",
        help="where textures go; default: beside what --save writes",
    )
    where.add_argument(
        "--pack", action="store_const", const=True, help="keep textures inside the .blend"
    )


def _add_exact(parser: _Parser) -> None:
    """What is stored beyond the transfer.  Not given is None: then the .blend's settings hold."""
    exact = parser.add_mutually_exclusive_group()
    exact.add_argument(
        "--no-residual",
        action="store_const",
        const=False,
        dest="residual",
        help="leave out what is exact at the baked world",
    )
    exact.add_argument(
        "--turns", type=_whole(1, 24), metavar="N", help="exact at N turns of the world about Z"
    )
    parser.add_argument(
        "--peaks", type=_whole(0, 4), metavar="N", help="suns and lamps that may be cut out"
    )
    parser.add_argument(
        "--final-light",
        action="store_const",
        const=True,
        help="the world stays: leave out what it does not show",
    )


def _add_where(parser: _Parser) -> None:
    add = parser.add_argument
    add("--save", type=Path, metavar="OUT.blend", help="write the baked scene")
    add("--gltf", type=Path, metavar="OUT.glb", help="write the baked scene as glTF")
    add(
        "--gltf-short",
        action="store_const",
        const=True,
        help="bakes in the .glb as 16-bit numbers: half the size",
    )
    add(
        "--gltf-error",
        type=_share,
        metavar="E",
        help="bakes on vertices in the .glb compressed to this error of the light: 0.01 or 1%%",
    )
    add(
        "--gltf-ibl",
        action="store_const",
        const=True,
        help="the world in the .glb as an image-based light, for viewers that know no bakes",
    )
    add("--report", type=Path, metavar="OUT.json", help="write the figures of the bake")
    add("--verify", action="store_true", help="trace some points again and print the error")


def _whole(smallest: int, largest: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = smallest - 1
        if not smallest <= value <= largest:
            message = f"{text!r} is no whole number from {smallest} to {largest}"
            raise argparse.ArgumentTypeError(message)
        return value

    return number


def _side(text: str) -> int:
    """A texture's side: a power of two."""
    value = _whole(16, 16384)(text)
    if value & (value - 1):
        message = f"{text!r} is no power of two: graphics cards halve textures again and again"
        raise argparse.ArgumentTypeError(message)
    return value


def _bounces(text: str) -> int:
    """So many, or all of them."""
    return ALL if text == "all" else _whole(0, 64)(text)


def _visibility_order(text: str) -> int:
    """So many bands, or none."""
    return 0 if text == "0" else _whole(2, 5)(text)


def _share(text: str) -> float:
    """A relative error, as a fraction or with a per cent sign."""
    number = text.strip()
    value = _positive(number.removesuffix("%")) / (100 if number.endswith("%") else 1)
    if not SMALLEST_ERROR <= value <= LARGEST_ERROR:
        message = f"{text!r} is no error from 0.1% to 50%"
        raise argparse.ArgumentTypeError(message)
    return value


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no positive number")
    return value
