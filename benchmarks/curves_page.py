"""Pictures and tables of what curves.py has measured."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

IMAGES = Path(__file__).parents[1] / "docs" / "images"

Curve = list[dict[str, Any]]
Measured = dict[str, Any]

OURS = "ours"
LEVELS = (0.01, 0.005)


@dataclass(frozen=True)
class Look:
    """How a method is called in tables and drawn."""

    title: str
    color: str
    marker: str


LOOKS = {
    OURS: Look("PRT Baker", "#d62728", "o"),
    "textbook": Look("textbook: numpy, embreex", "#7f7f7f", "s"),
    "mitsuba_independent": Look("Mitsuba, independent samples", "#1f77b4", "^"),
    "mitsuba_low_discrepancy": Look("Mitsuba, low-discrepancy", "#17becf", "v"),
    "mitsuba_our_directions": Look("Mitsuba, our directions", "#9467bd", "D"),
    "cycles": Look("Cycles, a bake per basis light", "#ff7f0e", "P"),
}


@dataclass(frozen=True)
class Aim:
    """At least ``least`` times ours is what ``method`` should take for a relative error of
    ``level`` in every one of ``scenes``; with ``level`` 0, for equal rays."""

    method: str
    level: float
    least: float
    scenes: tuple[str, ...]


FOLDED = ("knot", "cortex")
AIMS = (
    Aim("mitsuba_independent", 0.01, 35, FOLDED),
    Aim("mitsuba_independent", 0.005, 50, FOLDED),
    Aim("mitsuba_low_discrepancy", 0.01, 35, FOLDED),
    Aim("mitsuba_low_discrepancy", 0.005, 50, FOLDED),
    Aim("textbook", 0.01, 60, FOLDED),
    Aim("cycles", 0.01, 100, FOLDED),
    Aim("mitsuba_our_directions", 0, 0.65, ("suzanne", *FOLDED, "snowden", "city")),
    Aim("mitsuba_our_directions", 0, 1.0, ("field",)),
)


@dataclass(frozen=True)
class Seconds:
    """What an error takes; ``mark`` "~" where it lies beyond what was measured, "<" where the
    fewest rays measured already err less."""

    tracing: float
    whole: float
    mark: str = ""

    def __str__(self) -> str:
        return f"{self.mark}{figure(self.tracing)}"


def figure(value: float) -> str:
    """Three digits."""
    decimals = max(0, 2 - math.floor(math.log10(value))) if value > 0 else 0
    return f"{value:,.{decimals}f}"


def error_key(method: str) -> str:
    """Cycles starts at the vertices themselves, so only its noise counts."""
    return "noise" if method == "cycles" else "error"


def seconds_at(curve: Curve, method: str, level: float) -> Seconds:
    """Where ``curve`` comes down to ``level``: on a line between the two runs about it, in
    logarithms.  To the tracing comes what the whole takes besides."""
    errors = np.log([run[error_key(method)] for run in curve])
    besides = float(np.median([run["whole"] - run["tracing"] for run in curve]))
    target = math.log(level)
    below = np.flatnonzero(errors <= target)
    if not len(below):
        tracing, mark = beyond(curve, errors, target), "~"
    elif below[0] == 0:
        tracing, mark = curve[0]["tracing"], "<"
    else:
        before, after = int(below[0]) - 1, int(below[0])
        share = (target - errors[before]) / (errors[after] - errors[before])
        steps = [math.log(curve[k]["tracing"]) for k in (before, after)]
        tracing, mark = math.exp(steps[0] + share * (steps[1] - steps[0])), ""
    return Seconds(tracing, tracing + besides, mark)


def beyond(curve: Curve, errors: np.ndarray, target: float) -> float:
    """Seconds at the logarithm ``target`` of an error that no run has: the error falls on as it did
    over the last three, and the seconds grow as the rays do."""
    last = curve[-3:]
    power, _ = np.polyfit(np.log([run["rays"] for run in last]), errors[-3:], 1)
    return float(curve[-1]["tracing"] * math.exp((target - errors[-1]) / power))


def ratio_mark(ours: Seconds, peer: Seconds) -> str:
    """What a ratio of two marked figures may say."""
    if ours.mark == "<":
        return "" if peer.mark == "<" else ">"
    return peer.mark or ours.mark


def table(measured: Measured) -> str:
    """Seconds of every method in every scene at both levels, and how many times ours."""
    heads = [
        f"| {100 * level:g} %: seconds | times ours | the whole | times ours " for level in LEVELS
    ]
    lines = ["| scene | method " + "".join(heads) + "|", "|" + "---|" * (2 + 4 * len(LEVELS))]
    for scene in measured["scenes"].values():
        title = f"{scene['title']}, {scene['points']:,} points"
        for method in scene["methods"]:
            cells = [cell for level in LEVELS for cell in cells_at(scene, method, level)]
            lines.append(f"| {' | '.join([title, LOOKS[method].title, *cells])} |")
            title = ""
    return "\n".join(lines)


def cells_at(scene: Measured, method: str, level: float) -> tuple[str, str, str, str]:
    """Seconds of tracing and of the whole, each with its ratio to ours."""
    ours = seconds_at(scene["methods"][OURS], OURS, level)
    its = seconds_at(scene["methods"][method], method, level)
    if method == OURS:
        return str(its), "", f"{its.mark}{figure(its.whole)}", ""
    mark = ratio_mark(ours, its)
    return (
        str(its),
        f"{mark}{figure(its.tracing / ours.tracing)}",
        f"{its.mark}{figure(its.whole)}",
        f"{mark}{figure(its.whole / ours.whole)}",
    )


def speed(scene: Measured, method: str) -> float | None:
    """Times ours that ``method``'s tracing takes for equal rays, at the most that both traced."""
    its = {run["rays"]: run for run in scene["methods"].get(method, [])}
    both = [run for run in scene["methods"][OURS] if run["rays"] in its]
    if not both:
        return None
    most = max(both, key=lambda run: run["rays"])
    return its[most["rays"]]["tracing"] / most["tracing"]


def aims_table(measured: Measured) -> str:
    """What is aimed at, beside what was reached, tracing against tracing."""
    lines = ["| time of | for | at least | reached |", "|---|---|---|---|"]
    for aim in AIMS:
        found = [
            f"{name} {reached(scene, aim)}"
            for name, scene in measured["scenes"].items()
            if name in aim.scenes and aim.method in scene["methods"]
        ]
        goal = f"{100 * aim.level:g} %" if aim.level else "equal rays"
        cells = (LOOKS[aim.method].title, goal, f"{aim.least:g} times ours", ", ".join(found))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def reached(scene: Measured, aim: Aim) -> str:
    """The ratio of ``aim`` in ``scene``."""
    if not aim.level:
        ratio = speed(scene, aim.method)
        return "" if ratio is None else f"**{ratio:.2f}**"
    ours = seconds_at(scene["methods"][OURS], OURS, aim.level)
    its = seconds_at(scene["methods"][aim.method], aim.method, aim.level)
    return f"**{ratio_mark(ours, its)}{figure(its.tracing / ours.tracing)}**"


def notes(measured: Measured) -> Iterator[str]:
    """What the figures don't show: the references' errors, what is missing, biases."""
    scenes = measured["scenes"]
    worst = max(scene["reference"]["error"] for scene in scenes.values())
    points = max(scene["reference"]["points"] for scene in scenes.values())
    yield (
        f"The references, 2 x 65,536 rays at up to {points:,} points of a scene, err by at most "
        f"{100 * worst:.2g} % themselves."
    )
    offsets = [
        f"{name} {100 * scene['methods']['cycles'][-1]['bias']:.1f} %"
        for name, scene in scenes.items()
        if "cycles" in scene["methods"]
    ]
    if offsets:
        yield (
            "What two seeds of Cycles have in common against the reference, at the most samples "
            f"taken: {', '.join(offsets)}; it is not counted against Cycles."
        )
    compiling = [scene["compile_seconds"] for scene in scenes.values() if scene["compile_seconds"]]
    if compiling:
        yield (
            f"Compiling Mitsuba's kernels took up to {max(compiling):.1f} s a scene (drjit keeps "
            "them on disk from then on), which is in no figure."
        )
    missing = measured["missing"] | {k: v for s in scenes.values() for k, v in s["missing"].items()}
    for name, reason in missing.items():
        yield f"Not measured: {name.removeprefix('peer_')} ({reason})."


def tolerance_table(measured: Measured) -> str:
    """Measured error over the tolerance, and rays a point, of every object."""
    rows: dict[tuple[str, str], dict[float, str]] = {}
    for scene in measured["scenes"].values():
        for row in scene["tolerance"]:
            share = row["error"] / row["tolerance"]
            cells = rows.setdefault((scene["title"], row["object"]), {})
            cells[row["tolerance"]] = f"{share:.2f} ({row['rays']:,})"
    steps = sorted({tolerance for cells in rows.values() for tolerance in cells}, reverse=True)
    if not rows:
        return ""
    head = "".join(f"| {100 * step:g} % " for step in steps)
    lines = [f"| scene | object {head}|", "|" + "---|" * (2 + len(steps))]
    for (scene_title, name), cells in rows.items():
        values = " | ".join(cells.get(step, "") for step in steps)
        lines.append(f"| {scene_title} | {name} | {values} |")
    return "\n".join(lines)


def draw(measured: Measured) -> list[str]:
    """A picture a scene in docs/images; their lines of Markdown."""
    import matplotlib as mpl

    mpl.use("Agg")
    lines = []
    for name, scene in measured["scenes"].items():
        file = IMAGES / f"benchmark-{name}.png"
        draw_scene(scene, file)
        lines.append(f"![{scene['title']}: error against seconds](images/{file.name})")
    return lines


def draw_scene(scene: Measured, file: Path) -> None:
    """Error against seconds of every method, both in logarithms."""
    from matplotlib import pyplot

    figure_, axes = pyplot.subplots(figsize=(6.4, 4.6), dpi=100, layout="constrained")
    for method, curve in scene["methods"].items():
        look, errors = LOOKS[method], [100 * run[error_key(method)] for run in curve]
        drawn = {"color": look.color, "marker": look.marker, "markersize": 5}
        axes.loglog([run["tracing"] for run in curve], errors, label=look.title, **drawn)
        if method == OURS:
            whole = [run["whole"] for run in curve]
            axes.loglog(whole, errors, ":", label=f"{look.title}, the whole bake", **drawn)
    for level in LEVELS:
        axes.axhline(100 * level, color="0.7", linewidth=0.8, zorder=0)
    axes.set_title(
        f"{scene['title']}: {scene['points']:,} points, {scene['triangles']:,} triangles"
    )
    axes.set_xlabel("seconds")
    axes.set_ylabel("relative RMS error of the transfer, %")
    axes.grid(which="major", color="0.9", zorder=0)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    figure_.legend(loc="outside lower center", ncols=3, fontsize=7, frameon=False)
    figure_.savefig(file)
    pyplot.close(figure_)
