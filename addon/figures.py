"""Numbers in an artist's words, the same in panel, status bar and command line."""

from math import sqrt

from .prt.job import ALL, Progress
from .stamp import Stamp

COARSE = 0.02  # of error between the vertices is worth a word
PHASES = {
    "scene": "Reading the scene",
    "start": "Starting the engine",
    "light": "Reading the light",
    "prepare": "Preparing the scene",
    "horizon": "Finding what can be skipped",
    "effort": "Finding how many rays it takes",
    "choose": "Choosing between vertices and texture",
    "unwrap": "Unwrapping",
    "transfer": "Tracing",
    "bounces": "Letting the light bounce",
    "fill": "Filling the texture",
    "reflections": "Preparing reflections",
    "write": "Writing the texture",
    "verify": "Tracing again to verify",
}


def phase(progress: Progress) -> str:
    """What is being done."""
    return PHASES.get(progress.phase, progress.phase)


def percent(error: float) -> str:
    """A relative error as '12 %', '1.2 %' or 'under 0.1 %'."""
    value = 100 * error
    if value < 0.095:
        return "under 0.1 %"
    return f"{value:.1f} %" if value < 9.95 else f"{value:.0f} %"


def duration(seconds: float) -> str:
    """Seconds as '8 s', '2 min 05 s' or '1 h 04 min'."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def objects(count: int) -> str:
    """'1 object' or '3 objects'."""
    return f"{count} object" if count == 1 else f"{count} objects"


def progress_line(progress: Progress) -> str:
    """Phase, per cent and time left, as one line."""
    left = progress.seconds_left
    tail = f", {duration(left)} left" if left is not None else ""
    return f"{phase(progress)}, {100 * progress.fraction:.0f} %{tail}"


def stamp_lines(stamp: Stamp) -> list[str]:
    """What a bake says of itself: size, speed, and its errors where they are known."""
    return [
        f"order {stamp.order}{_bounces(stamp)}, {_size(stamp)}",
        *([stamp.why] if stamp.why else []),
        f"{stamp.rays:,} rays a point, {_speed([stamp])}",
        *_errors([stamp]),
    ]


def summary_lines(stamps: list[Stamp]) -> list[str]:
    """Several bakes together: how many, how large, how fast, and the worst of their errors."""
    points = sum(stamp.points for stamp in stamps)
    mrays = sum(map(_mrays, stamps))
    speed = f"{mrays:,.1f} Mrays, {_speed(stamps)}"
    return [f"{objects(len(stamps))}, {points:,} points", speed, *_errors(stamps)]


def advice(stamp: Stamp) -> str | None:
    """What would make a bake better where more rays would not."""
    noise, mesh = _noise(stamp), _mesh_error(stamp)
    if stamp.in_atlas or noise is None or mesh is None or mesh < max(COARSE, 1.5 * noise):
        return None
    return (
        f"{percent(mesh)} because the mesh is coarse: subdivide it where shadows fall, or bake to "
        "a texture"
    )


def why(carrier: str, predicted: dict[str, float]) -> str:
    """Why a bake is on vertices or in a texture, from what was predicted of both."""
    errors = [percent(predicted[f"{one}_error"]) for one in ("vertex", "texture")]
    sizes = [megabytes(predicted[f"{one}_bytes"]) for one in ("vertex", "texture")]
    if carrier == "vertex":
        here, there, other = 0, 1, "in a texture"
    else:
        here, there, other = 1, 0, "between vertices"
    return (
        f"{carrier} chosen: {errors[here]} error in {sizes[here]}, {other} {errors[there]} in "
        f"{sizes[there]}, predicted"
    )


def megabytes(size: float) -> str:
    """Bytes as '12 kB', '0.2 MB' or '48 MB'."""
    value = size / 1e6
    if value < 0.1:
        return f"{max(1, round(size / 1e3))} kB"
    return f"{value:.0f} MB" if value >= 9.95 else f"{value:.1f} MB"


def does_not_light(name: str) -> str:
    """That an object which shines lights nothing."""
    return f"{name!r} shines, but the bake holds the light of the world alone"


def _bounces(stamp: Stamp) -> str:
    if not stamp.bounces:
        return ""
    if stamp.bounces == ALL:
        return ", all bounces"
    return f", {stamp.bounces} bounce{'s' * (stamp.bounces > 1)}"


def another_light(name: str) -> str:
    """What to say of a bake whose residual belongs to another light than the last bake's."""
    return (
        f"{name!r} was baked under another world and shows soft shadows alone: "
        "bake it again for sharp ones"
    )


def _size(stamp: Stamp) -> str:
    """How many points or texels."""
    if stamp.in_atlas:
        return f"{stamp.points:,} texels of {stamp.atlas_size} x {stamp.atlas_size}"
    return f"{stamp.points:,} points"


def _mrays(stamp: Stamp) -> float:
    """Millions of rays that the bake stands for; fewer may have been traced."""
    return stamp.points * stamp.rays / 1e6


def _speed(stamps: list[Stamp]) -> str:
    """All rays over all seconds, of what was traced."""
    traced = [stamp for stamp in stamps if stamp.mrays_per_second > 0 and stamp.rays > 0]
    if not traced:
        return "nothing had to be traced"
    seconds = sum(_mrays(stamp) / stamp.mrays_per_second for stamp in traced)
    return f"{sum(map(_mrays, traced)) / seconds:.1f} Mrays/s"


def _errors(stamps: list[Stamp]) -> list[str]:
    lines = [*_transfer_errors(stamps), *_light_errors(stamps)]
    seen = _worst(stamps, "visibility_error")
    if seen is not None:
        lines.append(f"{percent(seen)} error of what is seen by reflections, measured")
    return lines


def _transfer_errors(stamps: list[Stamp]) -> list[str]:
    """Noise, and what the mesh loses between its vertices: estimated, and measured."""
    on_vertices = [stamp for stamp in stamps if not stamp.in_atlas]
    in_textures = [stamp for stamp in stamps if stamp.in_atlas]
    noise = _worst(on_vertices, "estimated_error")
    between, texture = _worst(stamps, "interpolation_error"), _worst(in_textures, "estimated_error")
    lines = [f"{percent(texture)} error of the texture, estimated"] if texture is not None else []
    if noise is not None:
        tail = f" and {percent(between)} between the vertices" if between is not None else ""
        lines.append(f"{percent(noise)} noise{tail}, estimated")
    measured, at_points = _worst(stamps, "measured_error"), _worst(stamps, "measured_at_points")
    if measured is not None:
        tail = f" ({percent(at_points)} at the vertices)" if at_points is not None else ""
        lines.append(f"{percent(measured)} error measured{tail}")
    return lines


def _light_errors(stamps: list[Stamp]) -> list[str]:
    """Of the light that leaves the surface, and under which world."""
    plain, light = _worst(stamps, "plain_error"), _worst(stamps, "light_error")
    lines = []
    if plain is not None:
        turns = max(stamp.packing.turns for stamp in stamps)
        where = f"{turns} turns of the baked world" if turns > 1 else "the baked world"
        lines.append(f"exact light at {where}, {percent(plain)} off under another one")
    if light is not None:
        there = all(stamp.light_at_bake for stamp in stamps)
        where = "at the baked world" if there else "under another world than the baked one"
        lines.append(f"{percent(light)} error of the light, measured {where}")
    return lines


def _worst(stamps: list[Stamp], name: str) -> float | None:
    """The largest of one error, None where no bake knows it."""
    known = [getattr(stamp, name) for stamp in stamps if getattr(stamp, name) is not None]
    return max(known, default=None)


def _noise(stamp: Stamp) -> float | None:
    return stamp.estimated_error if stamp.measured_at_points is None else stamp.measured_at_points


def _mesh_error(stamp: Stamp) -> float | None:
    """What lies between the vertices: measured where that was done, else estimated."""
    noise = _noise(stamp)
    if stamp.measured_error is None or noise is None:
        return stamp.interpolation_error
    return sqrt(max(0.0, stamp.measured_error**2 - noise**2))
