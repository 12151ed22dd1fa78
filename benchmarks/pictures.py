"""Pictures in EEVEE against Cycles' (diffuse light, no bounces, the world's full HDRI), all white.

Prints tables in Markdown for docs/benchmarks.md: the relative RMS of the pixels that show a mesh,
without Cycles' noise, under Blender's eight HDRIs.  The figures are 320 x 180 looks through the
middles of pixels.  Cycles' pictures are made once and kept in ``.cache/bench/pictures``.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import picture_bakes
import picture_files
import picture_scenes
import picture_truth
from picture_scenes import HDRIS
from picture_truth import Mask, Picture, Truth
from prt_baker.addon.prt.job import Settings

CACHE = picture_scenes.ROOT / ".cache" / "bench" / "pictures"
PROBE = "EEVEE's volume probe"
TURNS = (5.0, 20.0, 90.0)
HALF_STEP = 15.0  # twelve residuals are 30 degrees apart
PART_NAMES = {"body": "the knot's body", "scene": "the whole scene"}


@dataclass(frozen=True)
class Method:
    """How the scene is lit: a bake with ``settings``, made anew for every HDRI where it knows more
    of one than its coefficients, and the ``turns`` of the world, in degrees, that it is shown
    under afterwards.  Without settings it is EEVEE's volume probe."""

    name: str
    settings: Settings | None
    turns: tuple[float, ...] = (0.0,)

    @property
    def knows_its_world(self) -> bool:
        """Whether another HDRI needs another bake."""
        return self.settings is None or self.settings.residual or bool(self.settings.peaks)


def methods(scene: str) -> list[Method]:
    """What is compared; the turned worlds on the knot alone."""
    plain, all_turns = {"residual": False}, (0.0, *TURNS, HALF_STEP)
    on_knot = scene == "knot"
    found = [
        Method("plain SH, order 3", Settings(**plain), all_turns if on_knot else (0.0,)),
        Method("plain SH, order 5", Settings(order=5, **plain)),
        Method("with residual (defaults)", Settings(), (0.0, *TURNS) if on_knot else (0.0,)),
        Method("4 peaks, order 3", Settings(peaks=4, **plain)),
        Method("4 peaks, order 5", Settings(order=5, peaks=4, **plain)),
    ]
    if on_knot:
        found += [
            Method("12 turned residuals", Settings(turns=12), (0.0, HALF_STEP)),
            Method(PROBE, None),
        ]
    return found


@dataclass(frozen=True)
class Line:
    """Errors of one method under one turn of the world, by the part of the picture and the HDRI."""

    method: str
    turn: float
    errors: dict[str, dict[str, float]]

    @property
    def title(self) -> str:
        """What the table calls it."""
        return f"{self.method}, world turned by {self.turn:g}°" if self.turn else self.method

    def row(self, part: str, hdris: Sequence[str]) -> str:
        """One line of a table: every HDRI, the mean and the worst."""
        errors = [self.errors[part][hdri] for hdri in hdris]
        cells = [f"{100 * e:.1f}" for e in (*errors, np.mean(errors), max(errors))]
        return f"| {self.title} | {' | '.join(cells)} |"


class Benchmark:
    """One scene, open, with its masks; renders what it is asked for."""

    def __init__(self, scene: str, hdris: Sequence[str], folder: Path, images: Path | None) -> None:
        picture_scenes.SCENES[scene]()
        self.scene, self.hdris, self._folder, self._images = scene, hdris, folder, images
        numbers = picture_truth.objects(folder)
        self._parts: dict[str, Mask] = {"scene": numbers > 0}
        if scene == "knot":
            self._parts = {"body": numbers == 1, **self._parts}
        self._noise: dict[str, float] = {}

    def lines(self, chosen: Sequence[Method]) -> Iterator[Line]:
        """The errors of each method, at each of its turns."""
        for method in chosen:
            found = {t: {part: {} for part in self._parts} for t in method.turns}
            for hdri, turn, shown in self._pictures(method):
                truth = self._truth(hdri, turn)
                for part, mask in self._parts.items():
                    error = picture_truth.relative_error(shown, truth, mask)
                    found[turn][part][hdri] = error
            yield from (Line(method.name, turn, errors) for turn, errors in found.items())

    def tables(self, lines: Sequence[Line]) -> Iterator[str]:
        """A table for each part of the picture."""
        for part, mask in self._parts.items():
            where = PART_NAMES[part] if self.scene == "knot" else self.scene
            yield (
                f"| {where} ({np.count_nonzero(mask):,} pixels), % | "
                + " | ".join((*self.hdris, "mean", "worst"))
                + " |"
            )
            yield "|---" * (len(self.hdris) + 3) + "|"
            yield from (line.row(part, self.hdris) for line in lines)
            yield ""

    @property
    def noise(self) -> float:
        """Cycles' own noise, which the errors are free of: the mean over the HDRIs."""
        return float(np.mean(list(self._noise.values())))

    def _pictures(self, method: Method) -> Iterator[tuple[str, float, Picture]]:
        """What EEVEE shows under each HDRI and turn."""
        if method.settings is None:
            with picture_bakes.volume_probe():
                for hdri in self.hdris:
                    self._show(hdri, 0.0)
                    yield hdri, 0.0, picture_bakes.probe_picture(self._folder)
            return
        for place, hdri in enumerate(self.hdris):
            self._show(hdri, 0.0)
            if method.knows_its_world or not place:
                picture_bakes.bake_all(method.settings)
            for turn in method.turns:
                self._show(hdri, turn)
                shown = picture_bakes.picture(self._folder)
                if self._images is not None and not turn:
                    self._save(method, hdri, shown)
                yield hdri, turn, shown
        picture_bakes.remove_all()

    def _show(self, hdri: str, turn: float) -> None:
        picture_scenes.show_world(hdri, picture_scenes.TURN[self.scene] + turn)

    def _truth(self, hdri: str, turn: float) -> Truth:
        self._show(hdri, turn)
        truth = picture_truth.truth(CACHE)
        self._noise[hdri] = truth.noise(self._parts["scene"])
        return truth

    def _save(self, method: Method, hdri: str, shown: Picture) -> None:
        """The picture beside Cycles', and their difference."""
        truth = self._truth(hdri, 0.0)
        name = f"{self.scene} {hdri} {method.name}".replace(", ", " ").replace(" ", "-")
        picture_files.compare(self._images / f"{name}.png", shown, truth, self._parts["scene"])


def main() -> None:
    """The tables of each scene."""
    asked = _arguments()
    if asked.images is not None:
        asked.images.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, picture_bakes.add_on():
        for scene in asked.scene:
            benchmark = Benchmark(scene, asked.hdri, Path(folder), asked.images)
            chosen = [m for m in methods(scene) if any(part in m.name for part in asked.method)]
            lines = []
            for line in benchmark.lines(chosen):
                lines.append(line)
                print(line.title, line.errors, file=sys.stderr, flush=True)
            print("\n".join(benchmark.tables(lines)))
            print(f"Cycles' noise, not in these figures: {100 * benchmark.noise:.1f} %")
            print(flush=True)
    sys.stdout.flush()
    os._exit(0)  # Blender may crash in its own clean-up at exit


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", nargs="+", default=list(picture_scenes.SCENES))
    parser.add_argument("--hdri", nargs="+", default=HDRIS)
    parser.add_argument("--method", nargs="+", default=[""], help="parts of the methods' names")
    parser.add_argument("--images", type=Path, help="a folder for pictures to look at")
    return parser.parse_args()


if __name__ == "__main__":
    main()
