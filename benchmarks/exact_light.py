"""The error of the exact light at points, by how many rays are traced towards the map.

Random places of the torus knot over floor and wall under Blender's HDRIs, against visibility traced
through all texels.  Prints a table in Markdown.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
from real_light import OnTheKnot, small, studio_lights

CANDIDATES = 0, 66, 130, 258, 516  # about half of them are above a point's horizon


def row(knot: OnTheKnot, candidates: int, rays: int) -> str:
    """One line of the table."""
    found = [knot.error(i, candidates, rays) for i in range(len(knot.pictures))]
    errors, traced = np.array(found).T
    cells = [f"{100 * error:.2f}" for error in errors]
    cells += [f"**{100 * errors.mean():.2f}**", f"**{100 * errors.max():.2f}**"]
    return f"| {rays} | {traced.mean():.0f} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--places", type=int, default=1000)
    parser.add_argument("--rays", type=int, default=256, help="of the transfer")
    asked = parser.parse_args()
    files = studio_lights()
    names = " | ".join(file.stem for file in files)
    print(f"| transfer's rays | towards the map | {names} | mean | worst |")
    print("|---|---|" + "---|" * (len(files) + 2))
    knot = OnTheKnot(asked.places, [small(file) for file in files])
    for candidates in CANDIDATES:
        print(row(knot, candidates, asked.rays), flush=True)


if __name__ == "__main__":
    main()
