"""Reflections through a run of the engine: only where asked for, kept, and without the peaks."""

import numpy as np
import pytest
from prt_baker.addon.prt import reflecting
from prt_baker.addon.prt.job import Job, LightSource, Settings
from prt_baker.addon.prt.light import lat_long, peaks
from prt_baker.addon.prt.results import read_results, write_results
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.specular import sheet
from prt_baker.addon.prt.specular.sheet import PLAIN, Sheet
from prt_baker.addon.prt.steps import value_of

TURN = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def picture():
    towards = lat_long.directions(32, 64)
    pixels = (1 + 0.5 * towards).astype(np.float32)
    pixels[8:10, 20:22] = 500
    return pixels


@pytest.fixture(autouse=True)
def small(monkeypatch):
    fill = sheet.fill
    monkeypatch.setattr(sheet, "fill", lambda pixels, threads: fill(pixels, threads, (80, 40)))


def result_of(light, **settings):
    steps = run(Job("light", Settings(**settings), light))
    return value_of(steps)


def test_nothing_is_done_that_was_not_asked_for(picture):
    found = result_of(LightSource(pixels=picture))
    assert found.reflections is None
    assert "reflections" not in found.report["seconds"]


def test_results_read_as_written(picture, tmp_path):
    found = result_of(LightSource(pixels=picture), reflections=True)
    write_results(found, tmp_path)
    read = read_results(tmp_path).reflections
    assert read.sheet == found.reflections.sheet == Sheet((80, 40), 1, 1.0)
    assert read.path.stat().st_size > 1000
    assert found.reflections.image.dtype == np.float16
    up = sheet.radiance(read.sheet, found.reflections.image, np.array([[0, 0, 1.0]]), 0.5)
    assert up[0, 2] > up[0, 0]


def test_a_colour_takes_almost_nothing():
    found = result_of(LightSource((2, 3, 4)), reflections=True).reflections
    assert found.sheet.cell == PLAIN
    read = sheet.radiance(found.sheet, found.image, np.array([[0, 0.6, 0.8]]), 0.3)
    assert read == pytest.approx(np.ones((1, 3)), abs=1e-3)


def test_a_picture_is_filtered_once(picture, tmp_path, monkeypatch):
    asked = {"reflections": True, "cache": str(tmp_path)}
    first = result_of(LightSource(pixels=picture), **asked).reflections
    monkeypatch.setattr(reflecting.sheet, "fill", None)
    again = result_of(LightSource(pixels=picture), **asked).reflections
    assert np.array_equal(first.image, again.image)
    assert first.sheet == again.sheet


def test_peaks_are_cut_out_of_what_is_reflected(picture):
    cut = peaks.find(picture, TURN, (2, 2, 2), 1)
    rest = cut.rest(picture)
    assert rest.min() >= 0
    assert (rest <= picture).all()
    flux = lat_long.row_solid_angles(32, 64)[:, None, None]
    gone = ((picture - rest) * flux).sum(axis=(0, 1))
    assert gone == pytest.approx((cut.removed[0] * flux).sum(axis=(0, 1)), rel=1e-4)
    fine = np.repeat(np.repeat(picture, 32, axis=0), 32, axis=1)
    fine[256:260, 640:660] *= 3  # a sun that is finer than what it was found in
    many = peaks.find(fine, TURN, (2, 2, 2), 1)
    assert many.removed.shape[1] < len(fine)
    left = many.rest(fine)
    assert left.min() >= 0
    assert left[250:330, 630:710].max() < 0.05 * fine.max()
