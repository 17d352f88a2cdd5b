"""Files as people have them score as evo scores them, to 1e-9: camera axes, other clocks and units, sparse ones."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import Capsys, printed, refused, shown
from evo_scores import Drive, evo_metric
from scipy.spatial.transform import Rotation

CAMERA = Rotation.from_matrix([(0, -1, 0), (0, 0, -1), (1, 0, 0)])
"""From a robot's axes (ahead, left, up) to a camera's (right, down, ahead)."""
T0 = 1403636579.763555


def drive(n: int = 300, *, space: float = 0.0, seed: int = 0) -> Drive:
    """Stamps, positions and orientations of a robot that winds its way; ``space`` is how far it leaves the plane."""
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(n)
    heading = 0.8 * np.sin(0.5 * t) + 0.3 * t
    steps = np.column_stack((np.cos(heading), np.sin(heading), space * np.sin(t))) * 0.05
    tilts = space * np.column_stack((np.sin(1.3 * t), np.cos(0.7 * t)))
    turns = Rotation.from_euler("ZYX", np.column_stack((heading, tilts)))
    return T0 + t, np.cumsum(steps, axis=0) + rng.normal(size=3), turns


def disturbed(
    positions: np.ndarray,
    turns: Rotation,
    seed: int = 1,
    sigma: float = 0.03,
    *,
    space: float = 1.0,
    longer: float = 1.05,
):
    rng = np.random.default_rng(seed)
    off = Rotation.from_rotvec(0.02 * rng.normal(size=(len(turns), 3)) * (space, space, 1))
    noise = sigma * rng.normal(size=positions.shape) * (1, 1, space)
    return positions * (longer, 1.0, 1.0) + noise, turns * off


def in_camera_axes(positions: np.ndarray, turns: Rotation) -> tuple[np.ndarray, Rotation]:
    return CAMERA.apply(positions), CAMERA * turns * CAMERA.inv()


def write(path: Path, kind: str, stamps: np.ndarray, positions: np.ndarray, turns: Rotation) -> str:
    x, y, z, w = turns.as_quat().T
    if kind == "kitti":
        rows = np.dstack((turns.as_matrix(), positions[:, :, None])).reshape(-1, 12)
        np.savetxt(path, rows, "%.17g")
        np.savetxt(path.with_name(f"{path.stem}.times.txt"), stamps, "%.17g")
    elif kind == "euroc":
        table = np.column_stack((positions, w, x, y, z))
        rows = [
            f"{round(stamp * 1e6)}000,{','.join(map(repr, row))}"
            for stamp, row in zip(stamps.tolist(), table.tolist(), strict=True)
        ]
        path.write_text(
            "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []\n" + "\n".join(rows) + "\n"
        )
    else:
        scale = {"tum": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind]
        table = np.column_stack((positions, x, y, z, w))
        rows = [
            f"{stamp!r} {' '.join(map(repr, row))}" if scale == 1 else
            f"{round(stamp * 1e3) * scale // 1000} {' '.join(map(repr, row))}"
            for stamp, row in zip(stamps.tolist(), table.tolist(), strict=True)
        ]  # fmt: skip
        path.write_text("\n".join(rows) + "\n")
    return str(path)


def pair(folder: Path, estimate: Drive, reference: Drive, kind: str = "tum") -> list[str]:
    return [write(folder / f"{name}.{kind}", kind, *one) for name, one in (("est", estimate), ("ref", reference))]


def evo(estimate: Drive, reference: Drive, **how: Any) -> float:
    """The RMSE of evo's APE, or with a delta of its RPE."""
    return float(evo_metric(estimate, reference, **how).get_all_statistics()["rmse"])


def ours(capsys: Capsys, *arguments: str) -> dict:
    return shown(capsys, "evaluate", *arguments)


def rmse(result: dict, error: str = "ate", of: str = "translation_m") -> float:
    return result[error][of]["rmse"]


@pytest.mark.parametrize("kind", ["tum", "euroc", "kitti"])
@pytest.mark.parametrize("space", [0.0, 0.2])
def test_motion_out_of_x_and_y(tmp_path: Path, capsys, kind: str, space: float) -> None:
    """In camera axes; level, and up and down, too."""
    stamps, positions, turns = drive(space=space)
    estimate = (stamps, *in_camera_axes(*disturbed(positions, turns, space=space)))
    reference = (stamps, *in_camera_axes(positions, turns))
    files = pair(tmp_path, estimate, reference, kind)
    result = ours(capsys, *files)
    assert rmse(result) == pytest.approx(evo(estimate, reference), abs=1e-9)
    assert rmse(result, of="rotation_deg") == pytest.approx(
        evo(estimate, reference, relation="rotation_angle_deg"), abs=1e-6
    )
    assert rmse(result, "rpe") == pytest.approx(evo(estimate, reference, delta=1.0), abs=1e-9)
    assert "in-space" in [issue["code"] for issue in result["warnings"]]
    for options, how in ((("--scale",), {"lay": "scale"}), (("--no-align",), {"lay": "not"})):
        assert rmse(ours(capsys, *files, *options)) == pytest.approx(evo(estimate, reference, **how), abs=1e-9)


def test_a_flat_estimate_against_camera_axes(tmp_path: Path, capsys) -> None:
    stamps, positions, turns = drive()
    moved, turned = disturbed(positions, turns, space=0)
    estimate = (stamps, np.column_stack((moved[:, :2], np.zeros(len(moved)))), turned)
    reference = (stamps, *in_camera_axes(positions, turns))
    result = ours(capsys, *pair(tmp_path, estimate, reference))
    assert rmse(result) == pytest.approx(evo(estimate, reference), abs=1e-9)
    assert [issue["code"] for issue in result["warnings"]] == ["in-space", "body-axes"]


def test_heights_of_one_alone_are_left_out_with_a_warning(tmp_path: Path, capsys) -> None:
    stamps, positions, turns = drive()
    reference = positions + np.column_stack((np.zeros((300, 2)), 0.1 * np.sin(stamps)))
    flat = np.column_stack((positions[:, :2] + 0.001 * np.sin(7 * np.arange(600)).reshape(300, 2), np.zeros(300)))
    result = ours(capsys, *pair(tmp_path, (stamps, flat, turns), (stamps, reference, turns)))
    assert rmse(result) == pytest.approx(0.001, abs=1e-4)
    assert [issue["code"] for issue in result["warnings"]] == ["heights-left-out"]


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_stamps_of_another_unit(tmp_path: Path, capsys, unit: str) -> None:
    stamps, positions, turns = drive()
    stamps = np.round(stamps, 3)
    estimate = (stamps, *disturbed(positions, turns, space=0))
    files = (write(tmp_path / "e", unit, *estimate), write(tmp_path / "r", "tum", stamps, positions, turns))
    result = ours(capsys, *files)
    assert rmse(result) == pytest.approx(evo(estimate, (stamps, positions, turns)), abs=1e-9)
    assert result["ate"]["translation_m"]["count"] == 300
    assert [issue["code"] for issue in result["warnings"]] == ["stamps-scaled"]


@pytest.mark.parametrize("offset", [-2.5, 0.35, 7.0])
def test_a_clock_that_is_off(tmp_path: Path, capsys, offset: float) -> None:
    """The offset is found to a few milliseconds, printed, and taken where it is given."""
    stamps, positions, turns = drive(600)
    estimate = (stamps - offset, *disturbed(positions, turns, sigma=0.02, space=0, longer=1.0))
    files = pair(tmp_path, estimate, (stamps, positions, turns))
    [message] = [i["message"] for i in ours(capsys, *files)["warnings"] if i["code"] == "clocks-differ"]
    assert float(message.partition("--time-offset ")[2].strip("()")) == pytest.approx(offset, abs=0.01)
    result = ours(capsys, *files, "--time-offset", str(offset))
    assert rmse(result) == pytest.approx(evo(estimate, (stamps, positions, turns), offset=offset), abs=1e-9)
    assert result["warnings"] == []


def test_clocks_without_a_common_time(tmp_path: Path, capsys) -> None:
    stamps, positions, turns = drive(600)
    part = (stamps[50:500] - T0 - 2.0, positions[50:500], turns[50:500])
    said = refused(capsys, "evaluate", *pair(tmp_path, part, (stamps, positions, turns)))
    assert float(said.partition("--time-offset ")[2].strip("()\n")) == pytest.approx(T0 + 2.0, abs=0.01)


@pytest.mark.parametrize("sparse", ["estimate", "reference"])
@pytest.mark.parametrize("space", [0.0, 0.2])
def test_the_denser_side_is_interpolated(tmp_path: Path, capsys, sparse: str, space: float) -> None:
    stamps, positions, turns = drive(1000, space=space)
    some = np.arange(7, 990, 40)
    fine = np.linspace(stamps[0], stamps[-1], 4321)  # within 0.01 s of every stamp, as evo wants it
    turned = [np.interp(fine, stamps, turns.as_rotvec()[:, k]) for k in range(3)]
    path = np.column_stack([np.interp(fine, stamps, c) for c in positions.T])
    dense = (fine, path, Rotation.from_rotvec(np.transpose(turned)))
    thin = (stamps[some] + 0.003, *disturbed(positions[some], turns[some], space=space))
    both = (thin, dense) if sparse == "estimate" else (dense, thin)
    result = ours(capsys, *pair(tmp_path, *both))
    assert result["ate"]["translation_m"]["count"] == len(some)
    assert rmse(result) == pytest.approx(evo(*both, interpolate=True), abs=1e-9)
    assert rmse(result, "rpe") == pytest.approx(evo(*both, interpolate=True, delta=1.0), abs=1e-9)


@pytest.mark.parametrize("who", ["reference", "estimate"])
@pytest.mark.parametrize("quaternion", ["0 0 0 1", "0 0 0 0", "0.5 0.5 0.5 0.5"])
def test_positions_without_orientation(tmp_path: Path, capsys, quaternion: str, who: str) -> None:
    """Scored by distances, as evo's ``point_distance``, with a warning."""
    stamps, positions, turns = drive()
    estimate = (stamps, *disturbed(positions, turns, space=0))
    both = estimate, (stamps, positions, turns)
    files = pair(tmp_path, *both)
    file = Path(files[0 if who == "estimate" else 1])
    lines = [" ".join([*line.split()[:4], quaternion]) for line in file.read_text().splitlines()]
    file.write_text("\n".join(lines) + "\n")
    result = ours(capsys, *files)
    assert (result["oriented"], result["ate"]["rotation_deg"], result["rpe"]["rotation_deg"]) == (False, None, None)
    assert rmse(result) == pytest.approx(evo(*both), abs=1e-9)
    assert rmse(result, "rpe") == pytest.approx(evo(*both, relation="point_distance", delta=1.0), abs=1e-9)
    assert [issue["code"] for issue in result["warnings"]] == ["no-orientation"]
    out = printed(capsys, "evaluate", *files, "--metric", "heading", "--metric", "drift", "--metric", "ate")
    assert "RPE of distances over 1 m [" in out
    assert "deg" not in out
    assert re.search("final heading error +- no orientation", out)
    assert re.search("final drift +- a trajectory without orientation", out)
    printed(capsys, "evaluate", *files, "--plot", tmp_path / "p.png")
