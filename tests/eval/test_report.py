"""Maps and figures as files: what is in them, whichever way up, and nothing that breaks drawing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

from moteslam.errors import OutputError
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.report import curves, plans
from moteslam.eval.report.maps import map_image, trinary, write_map_png, write_map_server
from moteslam.eval.report.style import saved_figure
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.raster import Raster
from moteslam.robot.trajectory import Trajectory


@pytest.fixture
def occupancy() -> Raster:
    """Three cells by two: a wall at the lower left, free beside it, unknown above, one ray at the upper right."""
    log_odds = np.array([[9, -9, 0], [0, 0, -np.log(4)]], np.float32)
    return Raster(log_odds, 0.05, (-1.5, 2.25, 0.0))


def opened(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def test_the_top_of_a_picture_is_the_largest_y(occupancy: Raster) -> None:
    assert trinary(occupancy.values).tolist() == [[OCCUPIED, FREE, UNKNOWN], [UNKNOWN, UNKNOWN, FREE]]
    grey = map_image(occupancy.values)
    assert grey[0, :2].tolist() == [205, 205]
    assert 205 < grey[0, 2] < 254
    assert grey[1, :2].tolist() == [0, 254]


def test_one_hit_and_one_ray_decide_and_their_sum_does_not() -> None:
    one = np.float32(np.log(4))
    assert trinary(np.array([[one, -one, 0.0]])).tolist() == [[OCCUPIED, FREE, UNKNOWN]]


def test_map_server_files_read_back(occupancy: Raster, tmp_path: Path) -> None:
    write_map_server(tmp_path / "map.pgm", occupancy)
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


def test_map_png_reads_back(occupancy: Raster, tmp_path: Path) -> None:
    write_map_png(tmp_path / "map.png", occupancy)
    assert opened(tmp_path / "map.png").tolist() == map_image(occupancy.values).tolist()


def test_figures_are_white_outside_and_drawn_inside(run, simulation, tmp_path: Path) -> None:
    estimate, snapshots = run
    truth = simulation.truth
    ate = absolute_trajectory_error(estimate.trajectory, truth)
    name = r"[bold]$\frac{1}$ 東京" * 10 + "\udce9"  # a recording may be called anything
    plans.draw_trajectories(
        *(tmp_path / "trajectories.png", estimate.map),
        slam=estimate.trajectory,
        dead_reckoning=estimate.dead_reckoning,
        truth=truth,
        title=name,
    )
    plans.draw_over_time(tmp_path / "over_time.png", snapshots, trajectory=estimate.trajectory, title=name)
    plans.draw_dead_reckoning(
        tmp_path / "dead_reckoning.png", estimate.dead_reckoning, recording=simulation.recording, title=name
    )
    plans.draw_particles(
        tmp_path / "particles.png", estimate.particle_stamps, estimate.particle_paths, best=estimate.trajectory_final
    )
    curves.draw_error(tmp_path / "error.png", slam=ate, dead_reckoning=ate, title=name)
    files = sorted(tmp_path.glob("*.png"))
    assert len(files) == 5
    for file in files:
        image = opened(file)[..., :3]
        assert min(image.shape[:2]) > 300
        assert (image[0] == 255).all()
        assert (image[:, 0] == 255).all()
        assert len(np.unique(image.astype(int) @ [1, 256, 65536])) > 20


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were written."""
    figures: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, *a, **k: (figures.append(figure), save(figure, *a, **k)))
    return figures


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_legends_say_which_trajectory_and_which_start(run, tmp_path: Path, drawn: list[Figure]) -> None:
    estimate, snapshots = run
    ate = absolute_trajectory_error(estimate.trajectory, estimate.trajectory_final)
    plans.draw_trajectories(tmp_path / "a.png", estimate.map, slam=estimate.trajectory_final)
    plans.draw_over_time(tmp_path / "b.png", snapshots, trajectory=estimate.trajectory)
    curves.draw_error(tmp_path / "c.png", slam=ate)
    plans.draw_particles(tmp_path / "d.png", estimate.particle_stamps, estimate.particle_paths)
    assert [legend_of(figure) for figure in drawn] == [
        ["SLAM (final)", "start"],
        ["SLAM (online)", "robot"],
        [f"SLAM (online), RMSE {100 * ate.rmse:.1f} cm"],
        ["10 particles", "start"],
    ]
    whole, tenth = drawn[-1].axes
    assert [line.get_marker() for line in whole.lines].count("o") == 1
    assert [line.get_marker() for line in tenth.lines].count("o") == 0  # where it begins is not the start


def test_marks_of_resampling_hide_nothing_of_the_curve(tmp_path: Path, drawn: list[Figure]) -> None:
    n_eff = np.array([50.0, 20.0, 50.0])
    curves.draw_effective_particles(tmp_path / "a.png", np.arange(3.0), n_eff, n_eff < 30, particles=np.full(3, 50.0))
    curve, marks = drawn[0].axes[0].lines
    np.testing.assert_array_equal(curve.get_ydata(), n_eff)
    np.testing.assert_array_equal(marks.get_xdata(), [1.0])
    assert min(marks.get_ydata()) > 50
    assert legend_of(drawn[0]) == ["effective particles", "resampled (1)"]


def test_a_number_of_particles_that_changes_is_drawn(tmp_path: Path, drawn: list[Figure]) -> None:
    n_eff = np.array([50.0, 20.0, 15.0])
    numbers = np.array([50.0, 50.0, 20.0])
    curves.draw_effective_particles(tmp_path / "a.png", np.arange(3.0), n_eff, n_eff < 30, particles=numbers)
    assert legend_of(drawn[0]) == ["effective particles", "particles", "resampled (2)"]


def test_snapshots_are_taken_at_each_sixth(run) -> None:
    estimate, snapshots = run
    n = len(estimate.trajectory)
    assert [snapshot.index for snapshot in snapshots] == [n * k // 6 - 1 for k in range(1, 7)]
    known = [(snapshot.map.values != 0).sum() for snapshot in snapshots]
    assert known == sorted(known)


def test_a_robot_that_never_moved_can_be_drawn(occupancy: Raster, tmp_path: Path) -> None:
    still = Trajectory(np.array([1.0, 1.0]), np.zeros((2, 3)))
    plans.draw_trajectories(tmp_path / "a.png", occupancy, slam=still)
    plans.draw_dead_reckoning(tmp_path / "b.png", still)
    plans.draw_particles(tmp_path / "c.png", still.stamps[:1], np.zeros((3, 1, 3)), best=still)
    curves.draw_error(tmp_path / "d.png", slam=absolute_trajectory_error(still, still))
    curves.draw_effective_particles(tmp_path / "e.png", still.stamps, np.ones(2), np.zeros(2), particles=np.ones(2))
    assert len(list(tmp_path.glob("*.png"))) == 5


def test_a_figure_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="absent"), saved_figure(tmp_path / "absent" / "x.png", size=(3, 3)):
        pass


def test_curves_are_broken_where_nothing_was_measured() -> None:
    time = np.array([0.0, 0.1, 0.2, 5.2, 5.3, 6.2])
    x, y = curves.broken(time, np.arange(6.0))
    np.testing.assert_array_equal(x, [0.0, 0.1, 0.2, 5.2, 5.2, 5.3, 6.2])
    np.testing.assert_array_equal(y, [0, 1, 2, np.nan, 3, 4, 5])
    assert curves.broken(time[:1], time[:1])[0].tolist() == [0.0]
