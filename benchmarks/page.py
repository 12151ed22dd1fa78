"""make bench: measure and write docs/benchmarks.md."""

import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
PACKAGES = ("bpy", "numpy", "embreex", "OpenEXR")

TEMPLATE = """# Benchmarks

Written by `make bench`. {machine}, {packages}.

## Real inputs

The demo under several of Blender's HDRIs and a scanned bust of 109,000 faces on a plane (npm
`snowden`), baked from the command line with the default settings (order 3, 256 rays) and
`--verify`. The errors are relative RMS: of the transfer at the baked points and at random points of
the surface, traced again with 16,384 rays, and of the whole picture in EEVEE against Cycles
(diffuse, no bounces, 64 samples). Order 3 leaves the sharpest part of an HDRI's light out; that,
not the rays, is what is left of the pictures' difference, together with Cycles' own noise. The
error on the surface is pooled over the scene, and single points weigh much in it: nearly all of the
demo's comes from the rims of Suzanne's eyes, where light falls into a crevice narrower than a
triangle. *Whole command* starts Blender, reads the scene, bakes, verifies and writes everything.

{table}

## Rate

A whole bake of the torus knot, from arrays to arrays in the engine's own process, beside a bare
embreex loop over the same rays, taking turns. On a virtual machine the ratio varies between runs,
0.67 to 0.77 was seen.

```
{rate}
```
"""


def main() -> None:
    """Both measurements, then the page."""
    rate, table = run("bake_rate.py"), run("real_inputs.py")
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    text = TEMPLATE.format(
        machine=f"{processor()}, {platform.system()}, Python {platform.python_version()}",
        packages=packages,
        table=table,
        rate=rate,
    )
    PAGE.write_text(text, encoding="utf-8")


def run(script: str) -> str:
    """What a benchmark prints, its table or figures alone."""
    command = [sys.executable, Path(__file__).with_name(script)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    print(done.stdout, flush=True)
    lines = done.stdout.strip().splitlines()
    table = [line for line in lines if line.startswith("|")]
    return "\n".join(table or lines)


def processor() -> str:
    """The machine, in words."""
    from prt_baker.addon.prt.transfer import available_cores

    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].partition(":")[2].strip() if names else model
    return f"{available_cores()} cores of {model}"


if __name__ == "__main__":
    main()
