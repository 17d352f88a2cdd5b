"""``moteslam inspect --plot`` and ``--deep``: a picture of any recording, and what is read for it."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from sim_logs import winding

from moteslam.eval.cli import main
from moteslam.eval.report.streams import draw_streams
from moteslam.robot.formats import write_recording
from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platform import Platform
from moteslam.robot.recording import (
    EncoderStream,
    ImuStream,
    LidarStream,
    OdometryStream,
    Recording,
    RgbdStream,
)
from moteslam.robot.values import given_up
from moteslam.sim.logged import with_odometry

PNG = b"\x89PNG\r\n\x1a\n"
STREAMS = ("lidar", "encoders", "odometry", "imu", "rgbd")


def whole(seconds: float = 6.0) -> Recording:
    """A winding drive with every stream."""
    recording = winding(seconds=seconds)
    assert recording.encoders is not None
    stamps = recording.encoders.stamps
    return recording.replace(odometry=with_odometry(recording).odometry, rgbd=RgbdStream(stamps[::10], stamps[5::10]))


WHOLE = whole()


def drawn_of(recording: Recording, tmp_path: Path, figures: list[Figure]) -> Figure:
    """The figure of a recording, after it is on disk."""
    draw_streams(tmp_path / "x.png", recording, inspect_recording(recording))
    assert (tmp_path / "x.png").read_bytes().startswith(PNG)
    return figures[-1]


def lidar(stamps: np.ndarray, ranges: np.ndarray) -> LidarStream:
    return LidarStream(stamps, ranges.astype(np.float32), -1.0, 0.05, 0.1, 30.0)


@pytest.mark.slow
@pytest.mark.parametrize("names", [*combinations(STREAMS, 1), STREAMS], ids="-".join)
def test_any_streams_without_the_others(names: tuple[str, ...], tmp_path: Path, drawn: list[Figure]) -> None:
    part = WHOLE.replace(**{name: None for name in STREAMS if name not in names})
    figure = drawn_of(part, tmp_path, drawn)
    expected = [label for name in names for label in (("rgb", "disparity") if name == "rgbd" else (name,))]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == expected
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert ("range [m]" in labels) == ("lidar" in names)
    turning = set(names) - {"lidar", "rgbd"}
    assert ("yaw rate [rad/s]" in labels) == bool(turning)
    assert figure.axes[-1].get_xlabel() == "time since the first stamp [s]"


ONE = np.array([5.0])
RAGGED = np.full((3, 40), 2.0)
FAR = np.array([5.0, 6.0, 2e9])
ODD = {
    "one scan": {"lidar": lidar(ONE, np.full((1, 40), 2.0))},
    "one scan without an endpoint": {"lidar": lidar(ONE, np.full((1, 40), np.inf))},
    "scans of nothing but errors": {"lidar": lidar(np.arange(3.0), np.full((3, 40), np.nan))},
    "scans of one stamp": {"lidar": lidar(np.full(3, 5.0), RAGGED)},
    "scans of one beam": {"lidar": lidar(np.arange(3.0), RAGGED[:, :1])},
    "scans of no beam": {"lidar": lidar(np.arange(3.0), RAGGED[:, :0])},
    "no scans": {"lidar": lidar(ONE[:0], RAGGED[:0]), "odometry": OdometryStream(ONE, np.zeros((1, 3)))},
    "a gap of decades": {"lidar": lidar(FAR, RAGGED), "odometry": OdometryStream(FAR, np.zeros((3, 3)))},
    "clocks decades apart": {
        "lidar": lidar(np.arange(3.0), RAGGED),
        "odometry": OdometryStream(np.arange(3.0) + 1.7e9, np.zeros((3, 3))),
    },
    "one of each": {
        "lidar": lidar(ONE, RAGGED[:1]),
        "encoders": EncoderStream(ONE, np.zeros((1, 4), np.int64)),
        "odometry": OdometryStream(ONE, np.zeros((1, 3))),
        "imu": ImuStream(ONE, np.zeros((1, 3)), np.zeros((1, 3))),
    },
    "images alone": {"rgbd": RgbdStream(ONE, ONE[:0])},
    "two of each": {
        "encoders": EncoderStream(FAR[:2], np.ones((2, 4), np.int64)),
        "imu": ImuStream(FAR[:2], np.ones((2, 3)), np.zeros((2, 3))),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_odd_recordings(name: str, tmp_path: Path, drawn: list[Figure]) -> None:
    figure = drawn_of(Recording(name, Platform(), **ODD[name]), tmp_path, drawn)  # type: ignore[arg-type]
    for axes in figure.axes:
        assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    write_recording(tmp_path / "a.bag", whole().replace(rgbd=None))
    return tmp_path / "a.bag"


@pytest.fixture
def scans_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The chunks of ranges that are read from a file."""
    chunks: list[int] = []
    keep = lambda ranges: (chunks.append(len(ranges)), given_up(ranges))[1]  # noqa: E731
    monkeypatch.setattr("moteslam.robot.recording.given_up", keep)
    return chunks


@pytest.mark.slow
def test_all_ranges_of_a_bag_are_read_for_a_plot_or_deep(bag: Path, scans_read: list[int], drawn, capsys) -> None:
    assert main.run(["inspect", str(bag), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["lidar"]["no_return"] is None
    out = bag.with_name("new") / "a.PNG"
    for options in (["--deep"], ["--plot", str(out)]):
        scans_read.clear()
        assert main.run(["inspect", str(bag), *options, "--json"]) == 0
        assert scans_read
    assert out.read_bytes().startswith(PNG)
    assert "range [m]" in [axes.get_ylabel() for axes in drawn[0].axes]


def test_ranges_lie_at_their_stamps_and_shares_are_broken_in_gaps(tmp_path: Path, drawn: list[Figure]) -> None:
    """Key scans of uneven stamps; after 100 of them nothing for a minute."""
    steps = np.tile((0.4, 1.6), 100)
    steps[100] = 60.0
    stamps = np.cumsum(steps)
    figure = drawn_of(Recording("x", WHOLE.platform, lidar=lidar(stamps, np.full((200, 40), 2.0))), tmp_path, drawn)
    (panel,) = (axes for axes in figure.axes if axes.get_ylabel() == "range [m]")
    x, y = panel.lines[0].get_data()
    np.testing.assert_allclose(np.unique(x), stamps - stamps[0])
    assert set(y) == {2.0}
    (shares,) = (axes for axes in figure.axes if axes.get_ylabel() == "beams [%]")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(shares.lines[0].get_ydata())), [100])
