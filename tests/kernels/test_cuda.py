"""Every kernel on CUDA against the CPU: integers equal, floats within what the order of rounding can change.

Both backends run with ``fast_math`` off, so that sums and products are rounded alike and integers come out equal.
What may differ is the last bits of sin, cos, log and square root, and of products that a backend fuses with a sum.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from kernel_cases import MAX_RANGE, ROOM, Results, beams_of_scans, run_cases

pytestmark = pytest.mark.gpu


@pytest.fixture(scope="module")
def on_both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Results, Results]:
    """What the CPU computes, and CUDA, each in a process of its own."""
    folder = tmp_path_factory.mktemp("backends")
    cpu, cuda = run_cases(folder, arch="cpu", threads=2), run_cases(folder, arch="cuda", threads=2)
    assert cpu.keys() == cuda.keys()
    return cpu, cuda


def test_integers_are_equal(on_both: tuple[Results, Results]) -> None:
    """Random words, log-odds, flags, scores and which offset was best; and matched poses, which the host adds up."""
    cpu, cuda = on_both
    integers = [name for name, array in cpu.items() if array.dtype.kind in "iu"]
    poses = [name for name in cpu if name.startswith("match_poses") and name.endswith("poses")]
    assert (len(integers) >= 12, len(poses)) == (True, 3)
    for name in integers + poses:
        np.testing.assert_array_equal(cuda[name], cpu[name], name)


def test_sampled_motion_agrees(on_both: tuple[Results, Results]) -> None:
    """Within 1e-13 m and rad.

    In float64 a coordinate below 128 m is rounded to 1.4e-14 m, once in each of three steps. The functions are off
    by two units of the last place at most, 4.5e-16, on noise of up to 6.8 times 0.05 m and increments of 0.3 m: less.
    """
    cpu, cuda = (results["sample_motion"] for results in on_both)
    assert np.abs(cuda[:, :2] - cpu[:, :2]).max() <= 1e-13
    turned = cuda[:, 2] - cpu[:, 2]
    assert np.abs(turned - 2 * np.pi * np.rint(turned / (2 * np.pi))).max() <= 1e-13


def test_ranges_agree(on_both: tuple[Results, Results]) -> None:
    """Within the error of each against the exact range, twice: ``2 (4 E 2^-23 / |sin a| + 2^-21 r)``, see raycast.py.

    E is the room's extent and a the angle between beam and wall; walls run along the axes here, so ``|sin a|`` is no
    smaller than the smaller of the beam's ``|cos|`` and ``|sin|``. No beam passes a corner by less than 0.01 mm, so
    none meets another wall for rounding, and the same beams see nothing.
    """
    cpu, cuda = (results["cast_rays"] for results in on_both)
    np.testing.assert_array_equal(np.isfinite(cuda), np.isfinite(cpu))
    seen = np.isfinite(cpu)
    assert (np.abs(cuda[seen] - cpu[seen]) <= tolerances()[seen]).all()


def test_distance_maps_agree(on_both: tuple[Results, Results]) -> None:
    """To the rounding of float32 places, of up to 320 cells: 3e-5 cells, and a fused product halves or doubles that.

    Distances in cells are rounded to a step then, or to the next one; a cell whose centre lies so near to the end of
    a segment is updated or not, so that its weight differs: few. So do the scores of places that have a
    point so near to a cell's edge. Offsets follow from all points together, and end within Gauss-Newton's last step.
    """
    cpu, cuda = on_both
    np.testing.assert_allclose(cuda["thin_scan"], cpu["thin_scan"], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(cuda["project_scans"], cpu["project_scans"], rtol=0, atol=2e-6)  # at 20 m
    alike = cuda["integrate_scans: weights"] == cpu["integrate_scans: weights"]
    assert alike.mean() > 0.999
    assert np.abs(cuda["integrate_scans: steps"] - cpu["integrate_scans: steps"])[alike].max() <= 1
    apart = np.abs(cuda["register_scans: offsets"] - cpu["register_scans: offsets"])
    assert apart[:, :2].max() < 3e-4
    assert apart[:, 2].max() < 1e-4
    assert (cuda["search_scans: scores"] == cpu["search_scans: scores"]).mean() > 0.98
    assert (cuda["search_scans: shifts"] == cpu["search_scans: shifts"]).mean() > 0.98


def test_floors_agree(on_both: tuple[Results, Results]) -> None:
    """But for the pixels, points and cells that lie on an edge as float32 sees it: few."""
    cpu, cuda = on_both
    for kernel in ("render_colour", "render_disparity"):
        assert (cuda[kernel] == cpu[kernel]).mean() > 0.99
    one, other = (results["add_frame"][..., 3] for results in on_both)
    assert np.abs(one - other).sum() < 0.01 * one.sum()
    np.testing.assert_allclose(cuda["match_colours"], cpu["match_colours"], rtol=0.02, atol=2000)


def test_a_run_with_its_maps_on_the_gpu_finds_the_same_path(tmp_path: Path) -> None:
    """Within 2 cm, the spread between seeds: last digits decide which particle is drawn."""
    from moteslam.robot.trajectories import read_trajectory

    drive, program = tmp_path / "drive", (sys.executable, "-m", "moteslam")
    subprocess.run([*program, "simulate", "corridor", "--out", drive], check=True)
    paths = []
    for arch in ("cpu", "cuda"):
        out = tmp_path / arch
        words = ("--end", "20", "--arch", arch, "--no-figures")
        subprocess.run([*program, "replay", drive, "--out", out, *words], check=True)
        paths.append(read_trajectory(out / "trajectory_final.tum").poses)
    assert np.abs(paths[1] - paths[0])[:, :2].max() < 0.02


def tolerances() -> np.ndarray:
    """Of every beam [m]."""
    poses, beams = beams_of_scans()
    angles = poses[:, 2:] + beams
    square_on = np.minimum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    return 2 * (4 * max(ROOM) * 2.0**-23 / square_on + 2.0**-21 * MAX_RANGE)
