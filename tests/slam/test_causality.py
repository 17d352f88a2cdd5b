"""Online means causal: no online pose depends on what was measured after its scan.

A recording is cut at several scans: what is left is what has arrived when the last scan is complete and the
odometry has given its next reading. The online poses up to then are the same bytes as those of the complete recording.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from slam_messages import cut, jumping, logged, sparse_corridor

from moteslam.robot.formats import open_recording
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.slam.config import resolve_config
from moteslam.slam.inputs.step import Step, steps
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.online import OnlineSlam

pytestmark = pytest.mark.usefixtures("taichi")

Change = Callable[[Recording], Recording]
METHODS = {"paper": ["particles=20"], "default": ["particles=5"]}


@pytest.fixture(scope="module")
def corridor() -> Recording:
    return sparse_corridor()


def beginning_late(recording: Recording) -> Recording:
    """The odometry repeats its first pose for eight seconds, while the robot drives, and only then moves."""
    odometry = logged(recording).odometry
    first_poses = odometry.stamps < odometry.stamps[0] + 8.0
    poses = np.where(first_poses[:, None], odometry.poses[0], odometry.poses)
    return recording.replace(encoders=None, imu=None, odometry=OdometryStream(odometry.stamps, poses))


def same_step(a: Step, b: Step) -> bool:
    arrays = ("motion", "points", "origin")
    return (a.index, a.stamp, a.dt, a.measured) == (b.index, b.stamp, b.dt, b.measured) and all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in arrays
    )


def online(recording: Recording, preset: str) -> np.ndarray:
    """Every online pose, with its covariance, degenerate direction and state."""
    updates = OnlineSlam.over(recording, resolve_config(preset, METHODS[preset]), seed=0)
    return np.array([(*u.pose, *u.covariance.ravel(), u.degenerate, u.state) for u in updates])


def check(recording: Recording, preset: str, *, every: int, cuts: tuple[int, ...]) -> None:
    """Compare what the filter takes in, after every so many scans and around each jump, and the online trajectory."""
    sync = resolve_config(preset).sync

    def taken_in(recording: Recording) -> Iterator[Step]:
        return steps(synchronise(recording, sync))

    complete, jumped = list(taken_in(recording)), np.flatnonzero(synchronise(recording, sync).jumped)
    for scans in sorted({*range(1, len(complete), every), *jumped.tolist(), *(jumped + 1).tolist()}):
        pairs = zip(taken_in(cut(recording, scans)), complete[:scans], strict=True)
        assert all(same_step(a, b) for a, b in pairs), scans
    trajectory = online(recording, preset)
    for scans in cuts:
        assert online(cut(recording, scans), preset).tobytes() == trajectory[:scans].tobytes(), scans


@pytest.mark.parametrize("preset", METHODS)
@pytest.mark.parametrize(
    "change", [lambda r: r, logged, jumping, beginning_late], ids=["wheels", "logged", "jumping", "late"]
)
def test_online_poses_in_the_corridor_do_not_depend_on_what_comes_later(
    corridor: Recording, change: Change, preset: str
):
    check(change(corridor), preset, every=7, cuts=(40, 110))


@pytest.mark.slow
@pytest.mark.parametrize("preset", METHODS)
def test_online_poses_of_a_real_log_do_not_depend_on_what_comes_later(data_folder: Path, preset: str):
    recording = open_recording(data_folder / "intel" / "intel_key_scans.log.gz")
    check(cut(recording, 240), preset, every=17, cuts=(30, 120))
