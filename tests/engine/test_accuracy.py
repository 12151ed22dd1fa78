"""The error of a bake at 256 rays, against the same points at 32,768."""

from dataclasses import replace

import numpy as np
import shapes
from prt_baker.addon.prt.tracing import rays
from prt_baker.addon.prt.tracing.transfer import relative_rms
from prt_baker.addon.prt.verify import random_surface_points
from test_transfer import at, trace


def error_at_surface_points(receiver, sky, count, points=1000):
    """Relative RMS error of the nine coefficients at random points of the surface."""
    elements = len(receiver.normals)
    places = random_surface_points(
        replace(receiver, transfer=np.zeros((elements, 1, 9), np.float32)), points, 0
    )
    where = at(places.origins, places.normals)
    reference = trace(where, sky, count=32768, seed=1, threads=2)
    return relative_rms(trace(where, sky, count=count), reference)


def test_torus_knot_over_floor_and_wall():
    receiver, vertices, triangles = shapes.knot_scene()
    sky = rays.occlusion(vertices, triangles)
    assert error_at_surface_points(receiver, sky, 256) < 0.021
