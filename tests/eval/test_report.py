"""Maps, the coloured floor, figures and recordings as pictures: what is in them, which way up, degenerate runs."""

import json
import re
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w
from made_sweeps import swept
from matplotlib.figure import Figure
from PIL import Image
from sim_logs import winding
from slam_rooms import tiled_table

from moteslam.errors import InputError, OutputError
from moteslam.eval.cli import main
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.report import curves, maps
from moteslam.eval.report.curves import axis_title, draw_sweep, places_of
from moteslam.eval.report.maps import draw_over_time, with_opacity
from moteslam.eval.report.particles import Cloud, draw_particles
from moteslam.eval.report.streams import draw_streams
from moteslam.eval.results import write_map_files
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.store import Row
from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platform import Platform
from moteslam.robot.raster import Raster, read_map_arrays
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording, RgbdStream
from moteslam.robot.se2 import compose
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.logged import with_odometry
from moteslam.slam.texture.floor_map import TextureMap


@pytest.fixture
def occupancy() -> Raster:
    """Three cells by two: a wall at the lower left, free beside it, unknown above, one ray at the upper right."""
    log_odds = np.array([[9, -9, 0], [0, 0, -np.log(4)]], np.float32)
    return Raster(log_odds, 0.05, (-1.5, 2.25, 0.0))


def test_figures_are_white_outside_and_drawn_inside(run, simulation, tmp_path: Path) -> None:
    estimate, snapshots = run
    assert [index + 1 for index, _ in snapshots] == [len(estimate.trajectory) * k // 6 for k in range(1, 7)]
    truth = simulation.truth
    ate = absolute_trajectory_error(estimate.trajectory, truth)
    name = r"[bold]$\frac{1}$ 東京" * 10 + "\udce9"  # a recording may be called anything
    maps.draw_trajectories(
        *(tmp_path / "trajectories.png", estimate.map),
        slam=estimate.trajectory,
        dead_reckoning=estimate.dead_reckoning,
        truth=truth,
        title=name,
    )
    draw_over_time(
        *(tmp_path / "over_time.png", snapshots),
        **{"trajectory": estimate.trajectory, "placed": np.ones(len(estimate.trajectory), bool), "title": name},
    )
    maps.draw_dead_reckoning(
        tmp_path / "dead_reckoning.png", estimate.dead_reckoning, recording=simulation.recording, title=name
    )
    draw_particles(tmp_path / "particles.png", Cloud.of(estimate), title=name)
    curves.draw_error(tmp_path / "error.png", slam=ate, dead_reckoning=ate, title=name)
    files = sorted(tmp_path.glob("*.png"))
    assert len(files) == 5
    for file in files:
        image = cv2.imread(str(file))
        assert min(image.shape[:2]) > 300
        assert (image[0] == 255).all()
        assert (image[:, 0] == 255).all()
        assert len(np.unique(image.astype(int) @ [1, 256, 65536])) > 20


@pytest.mark.parametrize("oriented", [True, False])
def test_the_truth_is_laid_on_the_paths_wherever_its_frame_is(
    run, simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, oriented: bool
) -> None:
    drawn: list[list[np.ndarray]] = []
    monkeypatch.setattr(maps.style, "draw_paths", lambda _, *paths, **__: drawn.append([one for one, _ in paths]))
    final, odometry, true = run[0].trajectory_final, run[0].dead_reckoning, simulation.truth
    later = true.stamps > 5.0  # the truth may also begin later
    truth = Trajectory(true.stamps[later], compose((40.0, -7.0, 2.0), true.poses[later]), oriented)
    moved = Trajectory(odometry.stamps, compose((0.0, 9.0, 1.0), odometry.poses))
    maps.draw_trajectories(tmp_path / "a.png", run[0].map, slam=final, dead_reckoning=moved, truth=truth)
    maps.draw_dead_reckoning(tmp_path / "b.png", moved, truth=truth)
    within = final.stamps >= truth.stamps[0]

    def apart(path: np.ndarray, reference: np.ndarray) -> np.ndarray:
        return np.hypot(*(path[within] - reference)[:, :2].T)

    (reference, laid, slam), (begun, dead) = drawn
    rmse = [absolute_trajectory_error(one, truth).rmse for one in (final, moved)]
    assert [np.sqrt(np.square(apart(one, reference)).mean()) for one in (slam, laid)] == pytest.approx(rmse, rel=1e-6)
    assert (apart(dead, begun)[0] < 1e-9) == oriented
    assert oriented or np.sqrt(np.square(apart(dead, begun)).mean()) == pytest.approx(rmse[1], rel=1e-6)
    np.testing.assert_array_equal(slam, final.poses)


@pytest.mark.parametrize(
    ("draw", "field"),
    [
        (lambda estimate, axes, _: maps.draw_map(axes, estimate), "occupancy"),
        (lambda estimate, _, file: maps.draw_map(file, estimate.map), "axes"),
        (lambda estimate, axes, _: maps.draw_trajectories(axes, estimate.map, slam=estimate.trajectory), "path"),
        (lambda estimate, _, file: maps.draw_loops(file, estimate, [], trajectory=estimate.trajectory), "occupancy"),
        (lambda estimate, _, file: draw_particles(file, estimate), "cloud"),
        (lambda estimate, _, file: curves.draw_error(file, slam=estimate.trajectory), "slam"),
    ],
)
def test_what_is_drawn_of_and_on_is_of_its_kind(run, tmp_path: Path, draw: Any, field: str) -> None:
    with pytest.raises(InputError, match="expected") as caught:
        draw(run[0], Figure().subplots(), tmp_path / "x.png")
    assert (caught.value.field, list(tmp_path.iterdir())) == (field, [])


def test_a_path_is_that_of_slam_and_its_file_a_picture(run, tmp_path: Path, drawn: list[Figure]) -> None:
    maps.draw_trajectories(tmp_path / "x.png", run[0].map, slam=run[0].trajectory)
    assert [text.get_text() for text in drawn[0].legends[0].get_texts()] == ["SLAM", "start", "end"]
    with pytest.raises(OutputError, match=r"x.xyz: expected a name that ends in .png or .pdf or .svg"):
        maps.draw_trajectories(tmp_path / "x.xyz", run[0].map, slam=run[0].trajectory)


def test_a_robot_that_never_moved_can_be_drawn(occupancy: Raster, tmp_path: Path, drawn: list[Figure]) -> None:
    still = Trajectory(np.array([1.0, 1.0]), np.zeros((2, 3)))
    maps.draw_trajectories(tmp_path / "a.png", occupancy, slam=still)
    maps.draw_dead_reckoning(tmp_path / "b.png", still)
    ancestors = np.arange(3)[:, None]
    draw_particles(tmp_path / "c.png", Cloud(still.stamps[:1], np.zeros((3, 1, 3)), ancestors, np.zeros((1, 3))))
    (legend,) = drawn[-1].legends
    assert "standard deviation of all particles (ellipses: twice)" in [text.get_text() for text in legend.get_texts()]
    curves.draw_error(tmp_path / "d.png", slam=absolute_trajectory_error(still, still))
    curves.draw_effective_particles(tmp_path / "e.png", still.stamps, np.ones(2), np.zeros(2), particles=np.ones(2))
    assert len(list(tmp_path.glob("*.png"))) == 5


@pytest.mark.parametrize("below", [0.0, 0.5, 1.0])
def test_below_which_number_the_filter_resampled_is_drawn(below: float, tmp_path: Path, drawn: list[Figure]) -> None:
    given = np.arange(3.0), np.array([9.0, 4.0, 9.0]), np.array([0, 1, 0])
    curves.draw_effective_particles(tmp_path / "e.png", *given, particles=np.full(3, 10), below=below)
    shown = {line.get_label(): line.get_ydata() for line in drawn[0].axes[0].lines}
    threshold = shown.get("resampled below 0.5 of the particles")
    assert threshold is None if below != 0.5 else (threshold == 5.0).all()


def test_deviations_are_from_the_mean_along_and_across_the_heading() -> None:
    paths = np.zeros((2, 2, 3))
    paths[:, 0] = [(1.0, 0.0, np.pi / 2 - 0.1), (3.0, 4.0, np.pi / 2 + 0.1)]
    paths[:, 1, 2] = (np.pi - 0.1, 0.1 - np.pi)  # on both sides of the seam
    cloud = Cloud(np.zeros(2), paths, np.zeros((2, 2), np.int64), np.zeros((2, 3)))
    np.testing.assert_allclose(cloud.mean[0], (2.0, 2.0, np.pi / 2))
    np.testing.assert_allclose(cloud.deviations(np.array([1]))[0, 0], (2.0, -1.0, 0.1))
    assert abs(cloud.deviations(np.arange(2))[:, 1, 2]).max() == pytest.approx(0.1)


def made(scenario: str, configuration: str, error: float | None, **varied: bool | float | str) -> Row:
    run = PlannedRun(scenario=scenario, seed=0, configuration=configuration, varied=tuple(varied.items()))
    return Row(run, "failed" if error == inf else "ok", "", {"final.ate": {} if error is None else {"value": error}})


@pytest.mark.parametrize("errors", [(0.01, 0.1, 5.0), (0.1, inf, None), (inf, inf, inf), (0.0, 0.0, 0.0)])
def test_whatever_the_values_are_they_are_drawn(
    errors: tuple[float | None, ...], tmp_path: Path, drawn: list[Figure]
) -> None:
    rows = [made("corridor", "default", error, **{"slam.particles": k}) for k, error in enumerate(errors)]
    draw_sweep(tmp_path / "a.png", rows, ["final.ate"], column="slam.particles", label="$ [m]")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size[0] > 500
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 10
    assert drawn[0].get_suptitle() == "corridor"
    (legend,) = drawn[0].legends
    colours = dict(zip((text.get_text() for text in legend.get_texts()), legend.get_lines(), strict=True))
    assert colours["every run"].get_color() == colours["median"].get_color()


@pytest.mark.parametrize(
    ("column", "title"),
    [
        ("slam.map.cell_size", "map cell size [m]"),
        ("slam.particles", "particles"),
        ("scenario.noise.lidar.range_noise", "noise lidar range noise [m]"),
        ("platform.lidar.range_max", "lidar range max [m]"),
        ("platform.lidar.yaw", "lidar yaw [rad]"),
        ("slam.nothing", "nothing"),
        ("noise", "noise"),
        ("platform", "platform"),
    ],
)
def test_an_axis_has_the_unit_of_its_key(column: str, title: str) -> None:
    row = made("corridor", "default", 0.1)
    assert axis_title(column, [replace(row, run=row.run.with_(preset="default"))]) == title


def test_the_picture_has_the_largest_y_on_top(tmp_path: Path) -> None:
    colours = np.zeros((3, 2, 3), np.uint8)
    colours[0, 0], colours[2, 1] = (255, 0, 0), (0, 0, 255)
    points = np.array([[5, 0], [0, 0], [0, 1]])
    texture = TextureMap(values=colours, cell_size=0.5, origin=(-1.0, 2.5, 0.0), points=points, frames=7)
    colours = with_opacity(texture)
    assert colours[0, 0].tolist() == [255, 0, 0, 255]
    assert colours[2, 1].tolist() == [0, 0, 255, 255]
    assert (colours[..., 3] > 0).sum() == 2
    write_map_files(tmp_path, Raster(np.ones((1, 1), np.float32), 0.5, (0.0, 0.0, 0.0)), texture)
    file = cv2.imread(str(tmp_path / "texture.png"), cv2.IMREAD_UNCHANGED)
    assert file[2, 0].tolist() == [0, 0, 255, 255]
    assert "origin: [-1.0, 2.5, 0.0]" in (tmp_path / "texture.yaml").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_from_a_simulated_camera_to_the_result_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(tomli_w.dumps(tiled_table(rate=5.0, gap=0.0)))
    out, result = tmp_path / "recording", tmp_path / "result"
    assert main.run(["simulate", str(tmp_path / "s.toml"), "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["readings"]["rgb"] > 25
    assert re.search(r" images of about [1-9][0-9.]* MB are to be written", said.err)
    (out / "dataRGBD" / "RGB20" / "rgb20_7.png").write_bytes(b"broken")
    few = ["replay", str(out), "--set", "particles=5"]
    assert main.run([*few, "--out", str(result), "--set", "texture.largest_gap=0.11"]) == 0
    said = capsys.readouterr()
    assert "camera: 1 frame left out, unreadable; the first: " in said.err
    assert "Traceback" not in said.err
    picture = cv2.imread(str(result / "texture.png"), cv2.IMREAD_UNCHANGED)
    floor = {name: read_map_arrays(result / "texture.npz", name).values for name in ("points", "colours")}
    np.testing.assert_array_equal(picture[::-1, :, 3] > 0, floor["points"] > 0)
    known = floor["points"] > 0
    np.testing.assert_array_equal(picture[::-1, :, 2::-1][known], floor["colours"][known])
    assert (picture[..., 3] == 255).sum() > 3000
    assert cv2.imread(str(result / "texture_over_time.png")).shape[1] > 1000
    without = tmp_path / "without"
    assert main.run([*few, "--out", str(without), "--set", "texture.enabled=false", "--no-figures"]) == 0
    assert not (without / "texture.png").exists()


PNG = b"\x89PNG\r\n\x1a\n"
STREAMS = ("lidar", "encoders", "odometry", "imu", "rgbd")


DRIVE = winding(seconds=6.0)
FRAMES = RgbdStream(DRIVE.encoders.stamps[::10], DRIVE.encoders.stamps[5::10])
WHOLE = DRIVE.replace(odometry=with_odometry(DRIVE).odometry, rgbd=FRAMES)
"""With every stream."""


def drawn_of(recording: Recording, tmp_path: Path, figures: list[Figure]) -> Figure:
    """The figure of a recording, after it is on disk."""
    draw_streams(tmp_path / "x.png", recording, inspect_recording(recording))
    assert (tmp_path / "x.png").read_bytes().startswith(PNG)
    return figures[-1]


def lidar(stamps: np.ndarray, ranges: np.ndarray) -> LidarStream:
    return LidarStream(stamps, ranges.astype(np.float32), -1.0, 0.05, 0.1, 30.0)


@pytest.mark.slow
@pytest.mark.parametrize("names", [("lidar",), ("odometry",), ("rgbd",), STREAMS], ids="-".join)
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


@pytest.mark.parametrize(
    ("values", "places"),
    [
        ([10, 1.0, 3], {1.0: 1.0, 3: 3.0, 10: 10.0}),
        (["90", "45"], {"45": 45.0, "90": 90.0}),
        (["none", "graph", "none"], {"none": 0.0, "graph": 1.0}),
        ([True, False], {True: 0.0, False: 1.0}),
    ],
)
def test_numbers_lie_where_they_are_and_words_side_by_side(values: list[object], places: dict[object, float]) -> None:
    assert list(places_of(values).items()) == list(places.items())


def test_the_command(tmp_path: Path) -> None:
    file, out = swept(tmp_path), tmp_path / "new" / "a.png"
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--label", "window"]) == 0
    before = out.read_bytes()
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--x", "configuration", "--force"]) == 0
    assert out.read_bytes() != before
