"""Bakes by the whole engine, as the tests under stress start them: through a job's folder."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapes
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.steps import value_of

FULL = float(sh.basis([0.0, 0.0, 1.0], 1)[0])  # the first coefficient of an open point
PLAIN = {"rays": 256, "threads": 1, "fit": False, "residual": False}


def receiver(vertices, triangles, normals=None, name="shape"):
    """As ``shapes.receiver``, with the positions in float64 as Blender's side gives them."""
    made = shapes.receiver(vertices, triangles, normals, name)
    return replace(made, vertices=np.asarray(vertices, np.float64))


def job_of(receivers, vertices, triangles, light=None, **settings):
    """A bake of ``receivers`` among the occluders (V, 3), (F, 3)."""
    return jobs.Job(
        "bake",
        jobs.Settings(**(PLAIN | settings)),
        light or jobs.LightSource(),
        tuple(receivers),
        np.asarray(vertices, np.float64),
        np.asarray(triangles, np.int32),
    )


def bake(*things, **settings):
    """The results of ``job_of``, written, read back and run in this process."""
    with tempfile.TemporaryDirectory() as folder:
        jobs.write(job_of(*things, **settings), Path(folder))
        return value_of(run(jobs.read(Path(folder))))


def shown(results, place=0):
    """Transfer (E, n²) at every element of a receiver; all of them must show a point."""
    result = results.receivers[place]
    assert (result.element_points >= 0).all()
    return result.at_elements(result.transfer)[:, 0].astype(np.float64)


def alone(vertices, triangles, normals=None, **settings):
    """Transfer (E, n²) of a mesh that only shadows itself."""
    return shown(bake([receiver(vertices, triangles, normals)], vertices, triangles, **settings))


def visible(transfer):
    """The share of the sky, cosine-weighted, that points with ``transfer`` (..., n²) see."""
    return transfer[..., 0] / FULL


def open_error(transfer, normals):
    """The largest difference to an open sky's transfer about ``normals`` (E, 3)."""
    expected = sh.open_transfer(np.asarray(normals, np.float64), sh.order_of(transfer.shape[-1]))
    return float(np.abs(transfer - expected).max())


def turned(seed=1):
    """A rotation that lets no coordinate be a round number."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turn * np.linalg.det(turn)


def needles(origin, u, v, count):
    """A rectangle of ``count`` strips along ``v``, two long triangles each, facing u x v."""
    along = np.linspace(0, 1, count + 1)[:, None]
    low = np.asarray(origin) + along * np.asarray(u)
    k = np.arange(count)
    first, second = (
        np.stack([k, k + 1, k + count + 2], 1),
        np.stack([k, k + count + 2, k + count + 1], 1),
    )
    return np.concatenate([low, low + np.asarray(v)]), np.concatenate([first, second])
