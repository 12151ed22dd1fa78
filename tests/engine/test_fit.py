"""The least-squares fit: its forms, its solver, and what it does with noise."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.surface.edges import components
from prt_baker.addon.prt.surface.points import Surface
from prt_baker.addon.prt.surface.samples import Places, random_places, starts, stratified_places
from prt_baker.addon.prt.vertex import fit, fit_mesh


def sphere():
    vertices, triangles, normals = shapes.sphere(20, 40)
    return shapes.receiver(vertices, triangles, normals)


def flat(count=12):
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], count)
    return shapes.receiver(vertices, triangles, np.tile([0.0, 0, 1], (len(vertices), 1)))


def mesh_of(receiver):
    surface = Surface.of(receiver)
    triangles = receiver.triangles.astype(np.int64)
    areas = surface.areas
    return fit_mesh.mesh_of(triangles, surface.corners, areas, len(receiver.vertices)), surface


def dense(mesh, form):
    """The matrix that a form stands for."""
    matrix = np.diag(form.diagonal)
    for ends, values in ((mesh.edges, form.edges), (mesh.hinges[:, 2:], form.tips)):
        np.add.at(matrix, (ends[:, 0], ends[:, 1]), values)
        np.add.at(matrix, (ends[:, 1], ends[:, 0]), values)
    return matrix


def samples_of(mesh, places, values, surface):
    areas = np.full(len(places), surface.areas.sum() / len(places))
    parts = np.zeros(len(places), np.int64)
    return fit.Samples(places, values, areas, parts, np.ones(len(places), bool))


@pytest.mark.parametrize("receiver", [sphere(), flat()], ids=["sphere", "flat"])
def test_the_form_of_samples_is_their_squares(receiver):
    mesh, surface = mesh_of(receiver)
    random = np.random.default_rng(0)
    places, weights = random_places(surface.areas, 500, 1), random.random(500)
    x = random.normal(size=(mesh.count, 1)).astype(np.float32)
    shown = fit_mesh.interpolated(mesh, places, x)[:, 0].astype(np.float64)
    matrix = dense(mesh, fit_mesh.sample_form(mesh, places, weights))
    assert (x.T @ matrix @ x).item() == pytest.approx((weights * shown**2).sum(), rel=1e-5)


def test_a_linear_function_bends_nowhere():
    receiver = flat()
    mesh, _ = mesh_of(receiver)
    matrix = dense(mesh, fit_mesh.jump_form(mesh, np.ones(len(mesh.hinges))))
    x = receiver.vertices @ [3.0, -2, 0] + 1
    bent = x + 0.1 * np.random.default_rng(0).normal(size=len(x))
    assert x @ matrix @ x < 1e-9 * (bent @ matrix @ bent)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9


def test_the_form_of_jumps_is_that_of_gradients():
    """On a flat mesh the jump's square is that of the gradients' difference."""
    receiver = flat(5)
    mesh, surface = mesh_of(receiver)
    x = np.random.default_rng(0).normal(size=mesh.count)
    corners, values = surface.corners[:, :, :2], x[receiver.triangles]
    sides = corners[:, 1:] - corners[:, :1]
    gradients = np.linalg.solve(sides, (values[:, 1:] - values[:, :1])[..., None])[..., 0]
    owners = [np.flatnonzero((mesh.sides == k).any(axis=1)) for k in mesh.hinge_sides[:, 0]]
    expected = sum(
        surface.areas[pair].sum() ** 2 / 6 * ((gradients[pair[0]] - gradients[pair[1]]) ** 2).sum()
        for pair in owners
    )
    matrix = dense(mesh, fit_mesh.jump_form(mesh, np.ones(len(mesh.hinges))))
    assert x @ matrix @ x == pytest.approx(expected, rel=1e-6)


def test_the_solver_agrees_with_a_dense_one():
    receiver = sphere()
    mesh, surface = mesh_of(receiver)
    places = random_places(surface.areas, 900, 0)
    areas = np.full(900, 0.01)
    values = np.random.default_rng(1).normal(size=(900, 3)).astype(np.float32)
    data = fit_mesh.sample_form(mesh, places, areas)
    jumps = fit_mesh.jump_form(mesh, np.full(len(mesh.hinges), 0.3))
    spread = fit_mesh.Spread(mesh, places, areas)
    right = spread.sums(values)
    system = fit.System(mesh)
    system.set(data, jumps)
    found = system.solve(right, spread.averages(right), 1e-5)
    expected = np.linalg.solve(dense(mesh, data) + dense(mesh, jumps), right)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_a_linear_function_is_found_from_few_samples():
    receiver = flat()
    mesh, surface = mesh_of(receiver)
    places = random_places(surface.areas, 200, 0)
    origins = np.einsum("pk,pkc->pc", places.barycentric, surface.corners[places.triangles])
    values = (origins @ [[1.0], [2], [0]] + 3).astype(np.float32)
    samples = samples_of(mesh, places, values, surface)
    solver = fit.Fit(mesh, np.zeros(mesh.count, np.int64), 1)
    found, _ = solver.solve(samples, np.array([[0.1, 0.1]]), 1)
    missed = found - (receiver.vertices @ [[1.0], [2], [0]] + 3)
    assert np.sqrt((missed**2).mean()) < 0.01


def test_more_noise_takes_a_larger_weight():
    receiver = sphere()
    mesh, surface = mesh_of(receiver)
    places = random_places(surface.areas, 2000, 0)
    smooth = fit_mesh.interpolated(mesh, places, receiver.vertices[:, :1])
    random = np.random.default_rng(0).normal(size=smooth.shape)
    weights = [
        fit.best_weights(
            mesh,
            samples_of(mesh, places, (smooth + noise * random).astype(np.float32), surface),
            np.zeros(mesh.count, np.int64),
            1,
        )[0][0, 1]
        for noise in (1e-3, 1.0)
    ]
    assert weights[0] < weights[1]


def test_samples_left_out_tell_the_error():
    """Without noise in them they miss a fit by its error."""
    receiver = sphere()
    mesh, surface = mesh_of(receiver)
    places, tests = (random_places(surface.areas, n, n) for n in (3000, 5000))

    def at(places):
        origins = np.einsum("pk,pkc->pc", places.barycentric, surface.corners[places.triangles])
        return np.sin(9 * origins[:, :1]).astype(np.float32)

    parts = np.zeros(mesh.count, np.int64)
    samples = samples_of(mesh, places, at(places), surface)
    weights, missed = fit.best_weights(mesh, samples, parts, 1)
    found, _ = fit.Fit(mesh, parts, 1).solve(samples, weights, 1)
    error = ((fit_mesh.interpolated(mesh, tests, found) - at(tests)) ** 2).mean()
    assert missed[0] == pytest.approx(error, rel=0.4)


def test_a_crease_is_kept_and_the_noise_beside_it_is_not(monkeypatch):
    """A fit that holds what bends as what does not errs far more."""
    receiver = flat(20)
    mesh, surface = mesh_of(receiver)
    places = random_places(surface.areas, 900, 0)

    def at(positions):
        return np.abs(positions[:, :1] - 0.5).astype(np.float32)

    origins = np.einsum("pk,pkc->pc", places.barycentric, surface.corners[places.triangles])
    noise = 0.02 * np.random.default_rng(3).normal(size=(len(places), 1))
    samples = samples_of(mesh, places, (at(origins) + noise).astype(np.float32), surface)
    parts, errors = np.zeros(mesh.count, np.int64), []
    for _ in range(2):
        weights, _ = fit.best_weights(mesh, samples, parts, 1)
        found, _ = fit.Fit(mesh, parts, 1).solve(samples, weights, 1)
        errors.append(np.sqrt(np.mean((found - at(receiver.vertices)) ** 2)))
        monkeypatch.setattr(fit.Fit, "_stiffness", lambda *_: 1.0)
    assert errors[0] < 0.8 * errors[1]


def test_an_excerpt_is_the_mesh_of_its_triangles():
    receiver = sphere()
    mesh, surface = mesh_of(receiver)
    keep = receiver.vertices[:, 0] > 0.2
    part = fit_mesh.excerpt(mesh, keep)
    inside = keep[receiver.triangles].all(axis=1)
    number = np.cumsum(keep) - 1
    corners = number[receiver.triangles[inside]]
    expected = fit_mesh.mesh_of(
        corners, surface.corners[inside], surface.areas[inside], int(keep.sum())
    )
    ones = np.ones(len(part.hinges))
    assert len(part.hinges) == len(expected.hinges)
    np.testing.assert_allclose(
        dense(part, fit_mesh.jump_form(part, ones)),
        dense(expected, fit_mesh.jump_form(expected, ones)),
        atol=1e-9,
    )


def test_islands_are_told_apart():
    one, two = shapes.sphere(6, 8)[:2], shapes.grid([3, 0, 0], [1, 0, 0], [0, 1, 0], 3)
    vertices, triangles = shapes.join(one, two)
    receiver = shapes.receiver(vertices, triangles, np.ones((len(vertices), 3)))
    mesh, _ = mesh_of(receiver)
    names = components(mesh.edges, mesh.count)
    assert set(names[: len(one[0])]) == {0}
    assert set(names[len(one[0]) :]) == {len(one[0])}


def test_stratified_places_are_spread_and_off_the_edges():
    surface = Surface.of(flat())
    everything = np.arange(len(surface.areas))
    places = stratified_places(surface, everything, surface.areas, 4 * len(surface.areas), 0)
    assert places.barycentric.min() > 0.01
    counts = np.bincount(places.triangles, minlength=len(surface.areas))
    assert counts.min() >= 2
    assert counts.max() <= 6


def test_rays_start_above_the_tangent_planes_and_off_the_surface():
    receiver = sphere()
    surface = Surface.of(receiver)
    places = random_places(surface.areas, 300, 0)
    origins, normals = starts(surface, receiver.triangles, receiver.normals, places)
    assert np.linalg.norm(origins, axis=1).min() >= 1 - 1e-4
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


def test_normals_that_cancel_are_replaced_by_the_faces():
    surface = Surface.of(flat(1))
    places = Places(np.zeros(1, np.int64), np.full((1, 3), 1 / 3))
    nothing = np.zeros((3, 3), np.float32)
    _, normals = starts(surface, np.array([[0, 1, 2]]), nothing, places)
    np.testing.assert_allclose(normals, [[0, 0, 1]])
