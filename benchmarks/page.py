"""make bench: measure and write docs/benchmarks.md.

The short form measures what takes less than half an hour and keeps the rest of the page as it was.
"""

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import curves_page
from curves import about_machine
from scenes import CACHE

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "benchmarks.md"
BLENDERS = re.compile(r"[\d:]+:\d\d\.\d+ ")  # its log, which begins with the time
PACKAGES = ("bpy", "numpy", "embreex", "OpenEXR", "mitsuba", "nilearn")

HEAD = """# Benchmarks

Written by `make bench-full`; `make bench`, a short form of less than half an hour, measures some
sections again. Each section says where and how it was measured. On a virtual machine figures vary
between runs by a tenth and more; ratios, whose sides take turns in one run, vary less.
"""

CURVES = """How long a relative error of the transfer takes (order 3, nine coefficients, relative
RMS over random points), beside other ways to get there. All start from the same points and normals,
take turns, and have the same threads.

- *PRT Baker* is the engine's own process. *Seconds* are its tracing, finding what can be skipped
  included; *the whole* takes in the process, its files, finding points and what they show, Embree's
  structure and the error estimate.
- *Textbook* is Monte Carlo in numpy and embreex: random cosine-weighted directions, the basis for
  every ray.
- *Mitsuba* is its compiled LLVM kernel: visibility, basis and sums in registers, a lane a point,
  with its usual (not robust) intersections; *independent* is its default sampler, *low-discrepancy*
  the points of its `ldsampler`, the best of its own, *our directions* the baker's set and
  correction, made in the kernel. Its whole takes in the acceleration structure and no compilation.
- *Cycles* bakes diffuse light to vertices once for each signed part of each basis function, 17
  times; three functions at once in red, green and blue would take a third of that. Its rays start
  at the vertices themselves, which is sound on smooth meshes that touch nothing, so it is measured
  on those only; what counts is its noise alone, by how far two seeds differ.

"~" marks what lies beyond the measured range: the error falls on as over the last three counts of
rays, and the seconds grow with the rays. "<" and ">" stand where the fewest rays err less already.
"""

TOLERANCE = """What a bake that was asked for an error (`--tolerance`) has at the baked points,
measured over asked for, and in brackets the rays a point.
"""

REAL = """The demo under several of Blender's HDRIs and a scanned bust of 109,000 faces on a plane
(npm `snowden`), baked from the command line with the default settings and `--verify`. The errors
are relative RMS: of the transfer at the baked points and at random points of the surface, traced
again with 16,384 rays, and of the whole picture in EEVEE against Cycles (diffuse, no bounces, 64
samples, its noise included). Values on the surface are fitted to those points and err less than
they do where the mesh is fine enough. *Mrays/s* are over the whole of the transfer's time, which
the fit and the exact light take part of. *Whole command* starts Blender, reads the scene, bakes,
verifies and writes everything.
"""

SURFACE = """Relative RMS of the transfer at random places of the surface, interpolated as a
renderer does it, at equal rays: values fitted to samples inside the triangles against values traced
at the points.
"""

EXACT = """Relative RMS of the exit radiance of white surfaces, the HDRI's whole light, in %, at
1,000 random places of the torus knot over floor and wall, before anything is fitted or
interpolated. The pictures are Blender's at 256 x 128; the truth is visibility traced through all of
their texels, finer the more light a texel has, up to 128 x 128 rays for a sun. *Towards the map*
are the rays drawn in proportion to its light that a point traces beside the transfer's own; the
default is 128 in the mean, and without any only the transfer's rays look at the picture.
"""

PICTURES = """Relative RMS of the pixels that show a mesh, in EEVEE against Cycles (white, diffuse,
no bounces, the world's full HDRI), without Cycles' noise, in %. The torus knot lies over floor and
wall, the ground a grid of 200 x 200; where the world is turned it is turned after the bake. EEVEE's
own volume probe, without a bake of ours, makes one sun of all that is bright in the world.
"""

REFLECTIONS = """Spheres under three of Blender's HDRIs, each under the world alone: relative RMS
over their pixels, the mean of the HDRIs. *Formula* is what `docs/conventions.md` says, in numpy;
the *sum over texels* is what the same BRDF reflects of every texel of the HDRI, without split sum
and filter, so that its distance to Cycles is what the models differ. Paint is a dielectric over
diffuse colour; the white metal has both switches off in EEVEE and is a Glossy BSDF (GGX, which
scatters once) in Cycles.

![Paint and gold of roughness 0.2 to 1, in EEVEE above and in Cycles below](images/roughness.jpg)

*Gold and paint, of roughness 0.2, 0.4, 0.6, 0.8 and 1, under* courtyard. *Above: EEVEE. Below:
Cycles.*
"""

BOUNCES = """A box with a red and a green wall, a ball and a block in it: relative RMS of the pixels
that show a mesh, in EEVEE against Cycles with as many diffuse bounces, without Cycles' noise.
"""

BOUNCE_COST = """Whole bakes of about 100,000 points at vertices with three bounces beside the same
without, taking turns in the engine's own process: order 3, 256 rays, grey of albedo 0.7 or with
triangles of two colours. *Closed* is a well of five walls, *half open* the torus knot over a floor
and before a wall, which are not baked, *open* a sheet with hills. Without fit and residual less is
done besides, so bounces weigh more.
"""

SCALE = """A displaced sheet under a thousand rocks, ten million triangles together; and a thousand
boxes, which share nothing that an object needs.
"""

RATE = """A whole bake, from arrays to arrays in the engine's own process, beside a bare embreex
loop over the same rays, in the same order, with the same flags and threads, taking turns. *Its
work* is without what the loop is spared too: the start of a process, files and the acceleration
structure, which take some tenths of a second, and a small mesh (*cortex*) is traced in less; *its
tracing* makes the rays of the points, casts them and sums the coefficients. On the open field most
rays are known to reach the sky: the first ratios are to a bare loop over all of them, the last to
one over those that are cast.
"""


@dataclass(frozen=True)
class Section:
    """A part of the page: its ``title``, what is ``said`` first, and how its figures are made; not
    in the short form where that takes long."""

    title: str
    said: str
    measure: Callable[[bool], str]
    is_short: bool = False


def curves(is_full: bool) -> str:
    """Runs curves.py; its pictures, tables and notes."""
    subprocess.run(
        [sys.executable, HERE / "curves.py", *(["--full"] if is_full else [])], check=True
    )
    measured = measured_curves()
    parts = [curves_page.table(measured), *curves_page.notes(measured)]
    aims = "What is aimed at, tracing against tracing:"
    return "\n\n".join(
        [*parts, aims, curves_page.aims_table(measured), *curves_page.draw(measured)]
    )


def tolerance(_is_full: bool) -> str:
    """What curves.py has found of it."""
    return curves_page.tolerance_table(measured_curves())


def measured_curves() -> curves_page.Measured:
    """What curves.py has left."""
    found: curves_page.Measured = json.loads((CACHE / "curves.json").read_text(encoding="utf-8"))
    return found


def script(name: str) -> Callable[[bool], str]:
    """What the benchmark ``name`` prints: Markdown where it has tables, else as it stands."""

    def run(_is_full: bool) -> str:
        done = subprocess.run(
            [sys.executable, HERE / name], check=True, stdout=subprocess.PIPE, text=True
        )
        said = done.stdout.strip().splitlines()
        printed = "\n".join(line for line in said if not BLENDERS.match(line))
        is_table = any(line.startswith("|") for line in printed.splitlines())
        return printed if is_table else f"```\n{printed}\n```"

    return run


SECTIONS = (
    Section("Error against run time", CURVES, curves, is_short=True),
    Section("The error that was asked for", TOLERANCE, tolerance, is_short=True),
    Section("Rate", RATE, script("bake_rate.py"), is_short=True),
    Section("Error on the surface", SURFACE, script("surface_error.py"), is_short=True),
    Section("Exact light at the points", EXACT, script("exact_light.py"), is_short=True),
    Section("Pictures", PICTURES, script("pictures.py")),
    Section("Reflections", REFLECTIONS, script("specular.py")),
    Section("Bounces", BOUNCES, script("bounces.py")),
    Section("What bounces cost", BOUNCE_COST, script("bounce_cost.py")),
    Section("Scale", SCALE, script("scale.py")),
    Section("Real inputs", REAL, script("real_inputs.py")),
)


def main() -> None:
    """Measure section by section; the page is written after each, so none is lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="every section, larger scenes")
    titles = [section.title for section in SECTIONS]
    parser.add_argument("--section", action="append", choices=titles, help="only this one")
    asked = parser.parse_args()
    for section in SECTIONS:
        is_asked = section.title in asked.section if asked.section else asked.full
        if is_asked or (section.is_short and not asked.section):
            print(f"## {section.title}", flush=True)
            figures = section.measure(asked.full)
            print(figures, flush=True)
            write(section, f"{section.said}\n{where(asked.full)}\n\n{figures}")


def where(is_full: bool) -> str:
    """The machine and the versions, in words."""
    machine = about_machine()
    form = "full" if is_full else "short"
    return (
        f"*Measured in the {form} form: {machine['cores']} cores of {machine['processor']}, "
        f"{machine['system']}, Python {machine['python']}, {versions()}.*"
    )


def versions() -> str:
    """Of the packages that are installed."""
    found = []
    for name in PACKAGES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def write(section: Section, text: str) -> None:
    """Put ``text`` into the page as ``section``; the others stay."""
    old = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    parts = dict(part.split("\n", 1) for part in old.split("\n## ")[1:])
    parts[section.title] = f"\n{text}\n"
    order = [s.title for s in SECTIONS if s.title in parts]
    body = "".join(f"\n## {title}\n{parts[title].rstrip()}\n" for title in order)
    PAGE.write_text(HEAD + body, encoding="utf-8")


if __name__ == "__main__":
    main()
