"""What an inspection measures of a lidar is what went into its scans."""

import numpy as np
import pytest

from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, LidarStream, Recording
from moteslam.robot.sensor_reports import LidarReport

RNG = np.random.default_rng(1)


def measured(ranges: np.ndarray, *, increment: float = 0.01, counts: np.ndarray | None = None) -> LidarReport:
    """The report on scans ten times a second, of a robot whose wheels count this at each of them."""
    stamps = np.arange(len(ranges)) / 10
    counts = np.zeros(len(ranges), np.int64) if counts is None else counts
    recording = Recording(
        "x",
        UCSD,
        lidar=LidarStream(stamps, ranges.astype(np.float32), 0.5, increment, 0.1, 30.0),
        encoders=EncoderStream(stamps, np.repeat(counts[:, None], 4, axis=1)),
    )
    return inspect_recording(recording).lidar


def rounded(step: float, spread: float = 5.0) -> np.ndarray:
    return np.round(RNG.uniform(1, 1 + spread, (200, 100)) / step) * step


@pytest.mark.parametrize("step", [0.00025, 0.001, 1 / 256, 0.01, 0.013, 0.05])
def test_the_resolution_is_the_step_that_ranges_were_rounded_to(step: float) -> None:
    assert measured(rounded(step)).resolution == pytest.approx(step, rel=0.0005)


@pytest.mark.parametrize("count", [1, 50, 20_000, 100_000])
def test_ranges_that_were_not_rounded_have_no_resolution(count: int) -> None:
    assert measured(RNG.uniform(1, 6, (1, count)), increment=1e-5).resolution is None


@pytest.mark.parametrize(("increment", "turns"), [(0.01, "counterclockwise"), (-0.01, "clockwise")])
def test_angles_and_direction(increment: float, turns: str) -> None:
    report = measured(np.ones((3, 11)), increment=increment)
    assert (report.beams, report.angle_min, report.angle_increment, report.turns) == (11, 0.5, increment, turns)
    assert report.field_of_view == pytest.approx(np.degrees(0.1))


def test_nearest_and_farthest_are_of_endpoints_alone() -> None:
    report = measured(np.array([[np.nan, 0.2, 7.0, np.inf]]))
    assert (report.nearest, report.farthest) == (pytest.approx(0.2), 7.0)
    nothing = measured(np.full((2, 3), np.inf))
    assert (nothing.nearest, nothing.farthest, nothing.resolution, nothing.noise_at_rest) == (None,) * 4


def test_noise_is_measured_within_each_rest_and_not_on_the_way() -> None:
    places = np.array((2.0, 3.0, 4.0, 4.0))
    ranges = np.repeat(places, 50)[:, None] + RNG.normal(0, 0.012, (200, 300))
    ranges[50:100] += np.linspace(0, 3, 50)[:, None]  # on the way
    ranges[::7, 3], ranges[::9, 4] = np.nan, np.inf
    ranges[:, 0] += RNG.uniform(0, 3, 200)  # somebody walks through one beam
    ranges[:50, 200:] = np.inf  # in the first rest these meet nothing
    counts = np.repeat((0, 10, 0, 0), 50)
    noise = measured(ranges, counts=counts).noise_at_rest
    assert noise.deviation == pytest.approx(0.012, rel=0.05)
    assert noise.at_range == pytest.approx(4.0, abs=0.01)
    assert noise.beams == 500


def test_there_is_no_noise_at_rest_without_a_rest_or_encoders() -> None:
    assert measured(np.ones((50, 5)), counts=np.ones(50, np.int64)).noise_at_rest is None
    lidar = LidarStream(np.arange(50) / 10, np.ones((50, 5), np.float32), 0.0, 0.1, 0.1, 30.0)
    report = inspect_recording(Recording("x", UCSD, lidar=lidar)).lidar
    assert report.noise_at_rest is None


def test_beams_that_hardly_answer_have_no_noise() -> None:
    ranges = np.full((50, 5), np.nan)
    ranges[:9] = RNG.normal(2, 0.1, (9, 5))
    assert measured(ranges).noise_at_rest is None
