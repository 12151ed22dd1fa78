"""Numbers in an artist's words."""

from types import SimpleNamespace

import pytest
from prt_baker.addon import figures
from prt_baker.addon.prt.job import Progress


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
    mark = SimpleNamespace(estimated_error=noise, measured_error=error)
    assert (figures.advice(mark) is not None) == coarse


def test_the_speed_of_several_bakes_is_all_rays_over_all_seconds():
    common = {"points": 1_000_000, "rays": 100, "estimated_error": None, "measured_error": None}
    slow = SimpleNamespace(**common, mrays_per_second=1.0)
    fast = SimpleNamespace(**common, mrays_per_second=4.0)
    assert figures.summary_lines([slow, fast])[1] == "200.0 Mrays, 1.6 Mrays/s"
