"""How long the viewer draws a .glb in SwiftShader, beside three.js' MeshStandardMaterial.

Prints a line for each file.  ``python benchmarks/frame_times.py demo/demo.glb ...``
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "gltf"))
from viewer_frames import frame_times
from viewer_page import Page

COUNT = 15


def main() -> None:
    """Measure every file in one browser."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    page = Page()
    try:
        for path in parser.parse_args().files:
            baked, standard = frame_times(page, path.absolute(), COUNT)
            ratio = baked / standard
            print(f"{path.name}: {baked:.0f} ms, standard {standard:.0f} ms, ratio {ratio:.2f}")
    finally:
        page.close()


if __name__ == "__main__":
    main()
