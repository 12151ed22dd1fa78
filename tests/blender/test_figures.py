"""Numbers in an artist's words."""

from dataclasses import replace

import pytest
from prt_baker.addon import figures
from prt_baker.addon.prt.job import Progress
from prt_baker.addon.prt.layout import Layout
from stamped import MARK


def stamped(**values):
    """A stamp with ``values``, its errors unknown."""
    return replace(MARK, **{"estimated_error": None, **values})


@pytest.mark.parametrize(
    ("error", "words"),
    [(0.0, "under 0.1 %"), (0.0123, "1.2 %"), (0.0996, "10 %"), (0.256, "26 %"), (0.001, "0.1 %")],
)
def test_an_error_is_a_percentage_with_two_digits(error, words):
    assert figures.percent(error) == words


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0, "0 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (125, "2 min 05 s"), (3840, "1 h 04 min")],
)
def test_a_duration_is_read_at_a_glance(seconds, words):
    assert figures.duration(seconds) == words


def test_the_time_left_is_not_guessed_from_nothing():
    assert figures.progress_line(Progress("transfer", 0.01, 9, 3.0)) == "Tracing, 1 %"
    assert figures.progress_line(Progress("transfer", 0.5, 9, 8.0)) == "Tracing, 50 %, 8 s left"


def test_an_object_is_not_one_objects():
    assert figures.objects(1) == "1 object"
    assert figures.objects(2) == "2 objects"


@pytest.mark.parametrize(
    ("noise", "error", "coarse"),
    [(0.01, 0.36, True), (0.01, 0.02, False), (0.3, 0.4, False), (0.01, None, False)],
)
def test_a_coarse_mesh_is_told_from_too_few_rays(noise, error, coarse):
    mark = stamped(estimated_error=noise, measured_error=error)
    assert (figures.advice(mark) is not None) == coarse


def test_a_mesh_that_is_estimated_to_be_coarse_is_told_without_verifying():
    mark = stamped(estimated_error=0.01, interpolation_error=0.04)
    words = (
        "4.0 % because the mesh is coarse: subdivide it where shadows fall, or bake to a texture"
    )
    assert figures.advice(mark) == words
    assert figures.stamp_lines(mark)[2:] == [
        "1.0 % noise and 4.0 % between the vertices, estimated"
    ]


def test_what_was_measured_is_told_apart_from_what_is_estimated():
    mark = stamped(estimated_error=0.01, measured_error=0.05, measured_at_points=0.012)
    assert figures.stamp_lines(mark)[2:] == [
        "1.0 % noise, estimated",
        "5.0 % error measured (1.2 % at the vertices)",
    ]
    assert figures.advice(mark).startswith("4.9 % because")


@pytest.mark.parametrize(
    ("turns", "there", "words"),
    [
        (1, True, "exact light at the baked world, 26 % off under another one"),
        (12, False, "exact light at 12 turns of the baked world, 26 % off under another one"),
    ],
)
def test_the_error_of_the_light_says_under_which_world(turns, there, words):
    layout = Layout(3, turns=turns).slots
    mark = stamped(layout=layout, plain_error=0.256, light_error=0.02, light_at_bake=there)
    where = "at the baked world" if there else "under another world than the baked one"
    lines = [words, f"2.0 % error of the light, measured {where}"]
    assert figures.stamp_lines(mark)[2:] == lines
    assert figures.summary_lines([mark, stamped()])[2:] == lines


def test_what_reflections_see_is_measured_too():
    mark = stamped(layout=Layout(3, visibility_order=3).slots, visibility_error=0.031)
    line = "3.1 % error of what is seen by reflections, measured"
    assert figures.stamp_lines(mark)[2:] == [line]
    assert mark.packing == Layout(3, visibility_order=3)


def test_the_speed_of_several_bakes_is_all_rays_over_all_seconds():
    slow = stamped(points=1_000_000, rays=100, mrays_per_second=1.0)
    fast = stamped(points=1_000_000, rays=100, mrays_per_second=4.0)
    assert figures.summary_lines([slow, fast])[1] == "200.0 Mrays, 1.6 Mrays/s"
    known = stamped(points=1_000_000, rays=100, mrays_per_second=0.0)
    assert figures.summary_lines([slow, fast, known])[1] == "300.0 Mrays, 1.6 Mrays/s"
    assert figures.stamp_lines(known)[1] == "100 rays a point, nothing had to be traced"


def test_a_texture_says_its_size_its_error_and_why_it_is_one():
    predicted = {
        "vertex_error": 0.3, "texture_error": 0.012, "vertex_bytes": 2e5, "texture_bytes": 48e6
    }  # fmt: skip
    why = figures.why("texture", predicted)
    assert why == (
        "texture chosen: 1.2 % error in 48 MB, between vertices 30 % in 0.2 MB, predicted"
    )
    mark = stamped(carrier="texture", atlas_size=512, points=9000, estimated_error=0.01, why=why)
    size, reason, _, error = figures.stamp_lines(mark)
    assert size == "order 3, 9,000 texels of 512 x 512"
    assert reason == why
    assert error == "1.0 % error of the texture, estimated"
    assert figures.advice(mark) is None
    other = stamped(estimated_error=0.02, interpolation_error=0.001)
    lines = figures.summary_lines([mark, other])
    assert "1.0 % error of the texture, estimated" in lines
    assert "2.0 % noise and 0.1 % between the vertices, estimated" in lines
