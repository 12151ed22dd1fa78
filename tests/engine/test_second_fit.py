"""The second fit of the transfer, beside what is exact for one world."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.job import LightSource
from prt_baker.addon.prt.light import projection
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.tracing.transfer import relative_rms
from prt_baker.addon.prt.vertex import fit
from stressing import job_of, receiver


def lit(bounces):
    """Transfer (P, n²), and exit radiance of white under the baked world (P, 3), of the knot."""
    body, vertices, triangles = shapes.knot_scene(150, 16)
    knot = receiver(body.vertices, body.triangles, body.normals)
    pixels = np.full((32, 64, 3), 0.2, np.float32)
    pixels[9, 20:23] = 300
    source = LightSource(pixels=pixels)
    chosen = {"rays": 128, "fit": True, "residual": True, "turns": 3, "map_rays": 64}
    job = job_of([knot], vertices, triangles, source, **chosen)
    grey = np.full((len(triangles), 3, 3), 0.5, np.float32)
    settings = replace(job.settings, bounces=bounces)
    results = value_of(run(replace(job, settings=settings, occluder_albedo=grey)))
    (result,) = results.receivers
    radiance = projection.world_sh(results.image_sh, source.strength, np.eye(3))
    transfer = result.transfer.mean(axis=1)
    light = np.einsum("pi,ic->pc", transfer, radiance[: transfer.shape[1]])
    return transfer, light + result.residual[:, 0]


@pytest.mark.parametrize("bounces", [0, 2])
def test_the_baked_world_is_shown_as_without_it(monkeypatch, bounces):
    """The residual makes up for what it takes from the transfer."""
    twice = lit(bounces)
    real = fit.Fit.solve

    def once(self, samples, weights, *columns, **how):
        return real(self, samples, weights[:, [0, 0]], *columns, **how)

    monkeypatch.setattr(fit.Fit, "solve", once)
    monkeypatch.setattr(fit.Fit, "_stiffness", lambda *_: 1.0)
    alone = lit(bounces)
    assert relative_rms(twice[0], alone[0]) > 5e-3
    assert relative_rms(twice[1], alone[1]) < 2e-3
