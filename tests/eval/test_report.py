"""Maps, the coloured floor, figures and recordings as pictures: what is in them, which way up, degenerate runs."""

import json
import re
from dataclasses import replace
from itertools import combinations
from math import inf
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from command_lines import told
from figures import legend_of
from made_sweeps import swept
from matplotlib.figure import Figure
from PIL import Image
from sim_logs import winding

from moteslam.errors import InputError
from moteslam.eval.cli import main
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.report import curves, maps
from moteslam.eval.report.curves import draw_sweep, places_of
from moteslam.eval.report.maps import draw_over_time, with_opacity
from moteslam.eval.report.particles import Cloud, draw_particles
from moteslam.eval.report.streams import draw_streams
from moteslam.eval.report.style import broken
from moteslam.eval.results import write_map_files
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.store import Row
from moteslam.robot.formats import write_recording
from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platform import Platform
from moteslam.robot.raster import Raster, read_map_arrays
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording, RgbdStream
from moteslam.robot.se2 import compose
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import given_up
from moteslam.sim.logged import with_odometry
from moteslam.slam.texture.floor_map import TextureMap


@pytest.fixture
def occupancy() -> Raster:
    """Three cells by two: a wall at the lower left, free beside it, unknown above, one ray at the upper right."""
    log_odds = np.array([[9, -9, 0], [0, 0, -np.log(4)]], np.float32)
    return Raster(log_odds, 0.05, (-1.5, 2.25, 0.0))


def opened(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def test_map_server_files_read_back(occupancy: Raster, tmp_path: Path) -> None:
    write_map_files(tmp_path, occupancy)
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n3 2\n255\n" + bytes([205, 205, 254, 0, 254, 205])
    assert opened(tmp_path / "map.pgm").tolist() == [[205, 205, 254], [0, 254, 205]]
    about = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert about == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-1.5, 2.25, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def test_figures_are_white_outside_and_drawn_inside(run, simulation, tmp_path: Path) -> None:
    estimate, snapshots = run
    assert [snapshot.index + 1 for snapshot in snapshots] == [len(estimate.trajectory) * k // 6 for k in range(1, 7)]
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
    draw_over_time(tmp_path / "over_time.png", snapshots, trajectory=estimate.trajectory, title=name)
    maps.draw_dead_reckoning(
        tmp_path / "dead_reckoning.png", estimate.dead_reckoning, recording=simulation.recording, title=name
    )
    draw_particles(tmp_path / "particles.png", Cloud.of(estimate), title=name)
    curves.draw_error(tmp_path / "error.png", slam=ate, dead_reckoning=ate, title=name)
    files = sorted(tmp_path.glob("*.png"))
    assert len(files) == 5
    for file in files:
        image = opened(file)[..., :3]
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


def test_what_is_no_path_has_no_line_and_a_note_of_all_lines_stands_last(tmp_path: Path, drawn: list[Figure]) -> None:
    stamps = np.arange(400.0)
    true = Trajectory(stamps, np.column_stack((stamps, np.zeros((400, 2)))))
    still = Trajectory(stamps, np.zeros((400, 3)))
    raster = Raster(np.ones((4, 4), np.float32), 1.0, (0.0, 0.0, 0.0))
    maps.draw_trajectories(tmp_path / "a.png", raster, slam=true, dead_reckoning=still)
    assert legend_of(drawn[0]) == ["SLAM (final)", "start", "end"]
    ate = absolute_trajectory_error(true, true)
    curves.draw_comparison(tmp_path / "b.png", {"one/a.tum": ate, "two/a.tum": ate})
    assert legend_of(drawn[1])[-1] == "lines: running medians, bands: ranges"


@pytest.mark.parametrize(
    ("draw", "field"),
    [
        (lambda estimate, axes, _: maps.draw_map(axes, estimate), "occupancy"),
        (lambda estimate, _, file: maps.draw_map(file, estimate.map), "axes"),
        (lambda estimate, axes, _: maps.draw_trajectories(axes, estimate.map, slam=estimate.trajectory), "path"),
        (lambda estimate, _, file: maps.draw_loops(file, estimate, [], trajectory=estimate.trajectory), "occupancy"),
        (lambda estimate, _, file: draw_particles(file, estimate), "cloud"),
    ],
)
def test_what_is_drawn_of_and_on_is_of_its_kind(run, tmp_path: Path, draw: Any, field: str) -> None:
    with pytest.raises(InputError, match="expected") as caught:
        draw(run[0], Figure().subplots(), tmp_path / "x.png")
    assert (caught.value.field, list(tmp_path.iterdir())) == (field, [])


def test_a_robot_that_never_moved_can_be_drawn(occupancy: Raster, tmp_path: Path) -> None:
    still = Trajectory(np.array([1.0, 1.0]), np.zeros((2, 3)))
    maps.draw_trajectories(tmp_path / "a.png", occupancy, slam=still)
    maps.draw_dead_reckoning(tmp_path / "b.png", still)
    ancestors = np.arange(3)[:, None]
    draw_particles(tmp_path / "c.png", Cloud(still.stamps[:1], np.zeros((3, 1, 3)), ancestors, np.zeros((1, 3))))
    curves.draw_error(tmp_path / "d.png", slam=absolute_trajectory_error(still, still))
    curves.draw_effective_particles(tmp_path / "e.png", still.stamps, np.ones(2), np.zeros(2), particles=np.ones(2))
    assert len(list(tmp_path.glob("*.png"))) == 5


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["good.tum", "a/poor.tum"], ["good", "poor"]),
        (["a/good.tum", "b/good.tum"], ["a", "b"]),
        (["a/good.tum", "b/good.tum", "poor.tum"], ["a/good.tum", "b/good.tum", "poor.tum"]),
    ],
)
def test_files_are_named_as_shortly_as_tells_them_apart(names: list[str], short: list[str]) -> None:
    assert curves._short(names) == short


def test_curves_are_broken_where_nothing_was_measured() -> None:
    time = np.array([0.0, 0.1, 0.2, 5.2, 5.3, 6.2])
    x, y = broken(time, np.arange(6.0))
    np.testing.assert_array_equal(x, [0.0, 0.1, 0.2, 5.2, 5.2, 5.3, 6.2])
    np.testing.assert_array_equal(y, [0, 1, 2, np.nan, 3, 4, 5])
    assert broken(time[:1], time[:1])[0].tolist() == [0.0]


@pytest.fixture
def cloud() -> Cloud:
    """Four particles that drive 9 m along x: one ancestor for five updates, two for three, then four, 1 mm apart."""
    paths = np.zeros((4, 10, 3))
    paths[..., 0] = np.arange(10.0)
    paths[2:, 5:, 1] = 0.004
    paths[1::2, 8:, 1] += 0.001
    ancestors = np.zeros((4, 10), np.int64)
    ancestors[2:, 5:] = 1
    ancestors[:, 8:] = np.arange(4)[:, None]
    return Cloud(np.arange(10.0), paths, ancestors, np.full((10, 3), 0.002), best=2)


@pytest.fixture
def figure(cloud: Cloud, tmp_path: Path, drawn: list[Figure]) -> Figure:
    """The figure of these particles."""
    draw_particles(tmp_path / "particles.png", cloud)
    return drawn[0]


def test_deviations_are_from_the_mean_along_and_across_the_heading() -> None:
    paths = np.zeros((2, 2, 3))
    paths[:, 0] = [(1.0, 0.0, np.pi / 2 - 0.1), (3.0, 4.0, np.pi / 2 + 0.1)]
    paths[:, 1, 2] = (np.pi - 0.1, 0.1 - np.pi)  # on both sides of the seam
    cloud = Cloud(np.zeros(2), paths, np.zeros((2, 2), np.int64), np.zeros((2, 3)))
    np.testing.assert_allclose(cloud.mean[0], (2.0, 2.0, np.pi / 2))
    np.testing.assert_allclose(cloud.deviations(np.array([1]))[0, 0], (2.0, -1.0, 0.1))
    assert abs(cloud.deviations(np.arange(2))[:, 1, 2]).max() == pytest.approx(0.1)


def test_the_factor_is_printed_and_the_deviations_are_magnified_by_it(figure: Figure, cloud: Cloud) -> None:
    plan, _, across, _, _ = figure.axes
    assert plan.get_title() == "deviations magnified 100 times; ellipses: 2 standard deviations"
    paths = plan.collections[1].get_paths()
    drawn = np.array([path.vertices[-1, 1] for path in paths])
    true = cloud.paths[:, -1, 1]
    np.testing.assert_allclose(drawn - drawn.mean(), 100 * (true - true.mean()), atol=1e-9)
    assert across.get_ylabel() == "across [cm]"
    lines = across.collections[-1].get_segments()
    np.testing.assert_allclose([line[-1, 1] for line in lines], 100 * (true - true.mean()), atol=1e-9)


def test_what_is_not_magnified_says_nothing_of_it(cloud: Cloud, tmp_path: Path, drawn: list[Figure]) -> None:
    draw_particles(tmp_path / "a.png", replace(cloud, paths=cloud.paths * (1, 300, 1), spread=300 * cloud.spread))
    assert drawn[0].axes[0].get_title() == "ellipses: 2 standard deviations"


def test_a_deviation_that_leaves_its_panel_is_told_with_its_unit(tmp_path: Path, drawn: list[Figure]) -> None:
    spread = np.full((400, 3), 0.01)
    spread[7] = 0.05, 0.05, np.deg2rad(9.0)
    along = np.arange(400.0)
    paths = np.stack([np.column_stack((along, np.zeros((400, 2))))] * 2)
    draw_particles(tmp_path / "a.png", Cloud(along, paths, np.zeros((2, 400), np.int64), spread))
    titles = [axes.get_title("right") for axes in drawn[0].axes[1:4]]
    assert titles == [f"standard deviation up to {most} at 7 s" for most in ("5 cm", "5 cm", "9 deg")]


@pytest.mark.parametrize("scale", [1.0, 1e-3])  # dead reckoning is off by metres, or by millimetres
def test_the_floor_of_a_logarithmic_axis_follows_the_errors(scale: float, tmp_path: Path, drawn: list[Figure]) -> None:
    stamps = np.arange(100.0)
    true = Trajectory(stamps, np.column_stack((stamps, np.zeros(100), np.zeros(100))))
    wave = np.sin(stamps) * [[0.0], [1.0], [0.0]]
    near, far = (Trajectory(stamps, true.poses + (most * wave).T) for most in (0.001 * scale, 3.0 * scale))
    ate = [absolute_trajectory_error(one, true, align=False) for one in (near, far)]
    curves.draw_error(tmp_path / "a.png", slam=ate[0], final=ate[0], dead_reckoning=ate[1])
    assert drawn[0].axes[0].get_ylabel() == "position error [mm]"  # by the median, as in the table of scores
    (axes, _), (_, slam, *_) = drawn[0].axes, drawn[0].axes[0].lines
    assert axes.get_yscale() == "log"
    assert np.mean(slam.get_ydata() > axes.get_ylim()[0]) == pytest.approx(0.95, abs=0.02)


def test_ancestors_and_partings_are_drawn(figure: Figure) -> None:
    panel = figure.axes[-1]
    counts, partings = panel.lines
    assert counts.get_ydata().tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 4, 4]
    assert partings.get_xdata().tolist() == [5, 8]
    assert panel.get_title("left") == "ancestors of the 4 particles of the last update: one common ancestor until 4 s"
    assert {"start", "end", "lineages part (2 times)", "paths of 4 particles of the last update"} <= set(
        legend_of(figure)
    )


def made(scenario: str, configuration: str, error: float | None, **varied: bool | float | str) -> Row:
    run = PlannedRun(scenario=scenario, seed=0, configuration=configuration, varied=tuple(varied.items()))
    return Row(run, "failed" if error == inf else "ok", "", {"final.ate": {} if error is None else {"value": error}})


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


def test_a_colour_a_scenario_and_dashes_a_configuration(tmp_path: Path, drawn: list[Figure]) -> None:
    rows = [
        made(scenario, configuration, value, **{"slam.particles": count})
        for scenario in ("corridor", "office")
        for configuration in ("default", "paper")
        for count, value in ((10, 0.1), (3, 0.2))
    ]
    draw_sweep(tmp_path / "a.png", rows, ["final.ate"], column="slam.particles")
    lines = [line for line in drawn[0].axes[0].lines if len(line.get_xdata()) == 2 and line.get_label()[0] != "_"]
    assert legend_of(drawn[0])[:4] == ["corridor, default", "corridor, paper", "office, default", "office, paper"]
    colours, dashes = [line.get_color() for line in lines], [line.get_linestyle() for line in lines]
    assert colours[0] == colours[1] != colours[2]
    assert dashes[0] == dashes[2] != dashes[1]
    np.testing.assert_allclose(lines[0].get_xdata(), [3, 10], rtol=0.05)
    np.testing.assert_allclose(lines[0].get_ydata(), [20, 10])  # [cm]


def test_in_one_scenario_colours_tell_configurations_apart(tmp_path: Path, drawn: list[Figure]) -> None:
    rows = [made("corridor", name, 0.1 * k, **{"slam.particles": k}) for name in ("a", "b") for k in (1, 2)]
    draw_sweep(tmp_path / "a.png", rows, ["final.ate"], column="slam.particles")
    first, second = [line.get_color() for line in drawn[0].axes[0].lines if line.get_label() in ("a", "b")]
    assert first != second


def test_panels_have_the_same_places_and_a_dash_where_nothing_was_measured(tmp_path: Path, drawn: list[Figure]) -> None:
    ours, theirs = made("corridor", "ours", 0.1), made("corridor", "theirs", 0.2)
    ours = replace(ours, scores={**ours.scores, "online.ate": {"value": 0.3}})
    draw_sweep(tmp_path / "a.png", [ours, theirs], ["online.ate", "final.ate"], column="configuration")
    online, final = drawn[0].axes
    assert online.get_xlim() == final.get_xlim()
    assert [(text.get_text(), text.get_position()[0]) for text in online.texts] == [("-", 1.0)]
    assert not final.texts


def test_commands_are_one_series_and_a_failed_one_is_a_whole_marker(tmp_path: Path, drawn: list[Figure]) -> None:
    rows = []
    for name, error, version in (("ours", 0.1, ""), ("theirs", 0.2, "icp 2"), ("broken", inf, "1")):
        row = made("corridor", name, error)
        rows.append(replace(row, run=row.run.model_copy(update={"command": (("x",), "carmen", "a", "b", version)})))
    draw_sweep(tmp_path / "a.png", rows, ["final.ate"], column="configuration")
    assert legend_of(drawn[0]) == ["median", "half of the runs or more failed", "every run"]
    assert drawn[0].axes[0].get_ylabel().startswith("final ATE")
    axes = drawn[0].axes[0]
    (failed,) = [line for line in axes.lines if line.get_markersize() == 9 and len(line.get_xdata())]
    assert not failed.get_clip_on()
    assert [*failed.get_xdata()] == [2.0]  # at its tick
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["ours", "theirs", "broken"]


@pytest.mark.parametrize(
    "errors", [(0.1, 0.2, 0.3), (0.01, 0.1, 5.0), (0.1, inf, None), (inf, inf, inf), (0.0, 0.0, 0.0)]
)
def test_whatever_the_values_are_they_are_drawn(errors: tuple[float | None, ...], tmp_path: Path) -> None:
    rows = [made("corridor", "default", error, **{"slam.particles": k}) for k, error in enumerate(errors)]
    draw_sweep(tmp_path / "a.png", rows, ["final.ate"], column="slam.particles", label="$ [m]")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size[0] > 500
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 10


def test_the_command(tmp_path: Path) -> None:
    file, out = swept(tmp_path), tmp_path / "new" / "a.png"
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--label", "window"]) == 0
    before = out.read_bytes()
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--x", "configuration", "--force"]) == 0
    assert out.read_bytes() != before


SCENARIO = """
duration = 12.0
[world]
rooms = [{ corner = [0.0, 0.0], size = [9.0, 7.0] }]
[[world.boxes]]
centre = [6.0, 2.0]
size = [0.8, 0.6]
[commands]
start = [2.0, 2.0, 0.3]
steps = [{ duration = 6.5, speed = 0.6, turn_rate = 0.35 }]
[drive]
rest_start = 0.5
rest_end = 0.5
[camera]
rate = 5.0
gap = 0.0
"""


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
def test_from_a_simulated_camera_to_the_result_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO)
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
    capsys.readouterr()
    monkeypatch.setattr("moteslam.slam.texture.floor_map.MAX_CELLS", 10)
    assert "warning: the floor is not coloured: texture.cell_size: " in told(
        capsys, *few, "--out", tmp_path / "large", "--no-figures"
    )
    assert (tmp_path / "large" / "map.png").exists()


PNG = b"\x89PNG\r\n\x1a\n"
STREAMS = ("lidar", "encoders", "odometry", "imu", "rgbd")


def whole(seconds: float = 6.0) -> Recording:
    """A winding drive with every stream."""
    recording = winding(seconds=seconds)
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
    write_recording(tmp_path / "a.bag", whole().replace(rgbd=None, encoders=None, odometry=None, imu=None))
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
