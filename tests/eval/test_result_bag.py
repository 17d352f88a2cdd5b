"""A result as MCAP: map, paths and loops in the frame of the map, beside what was recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from moteslam.errors import InputError
from moteslam.eval.cli import main
from moteslam.eval.result_bag import write_result_bag
from moteslam.robot import se2
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.map_server import trinary
from moteslam.robot.trajectory import Trajectory


def test_the_bag_holds_map_paths_and_scans_and_its_transforms_lead_along_the_final_path(
    simulation, run, tmp_path: Path
) -> None:
    estimate, _ = run
    file = tmp_path / "result.mcap"
    write_result_bag(file, estimate, simulation.recording)
    last: dict[str, object] = {}
    moved: dict[str, dict[float, np.ndarray]] = {"map": {}, "odom": {}}
    with AnyReader([file]) as reader:
        for connection, time, data in reader.messages():
            last[connection.topic] = message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/tf":
                (one,) = message.transforms
                place, turn = one.transform.translation, one.transform.rotation
                pose = np.array((place.x, place.y, 2 * np.arctan2(turn.z, turn.w)))
                moved[one.header.frame_id][time / 1e9] = pose
    grid = last["/map"]
    assert (grid.info.height, grid.info.width) == estimate.map.shape
    cells = grid.data.reshape(estimate.map.shape)
    np.testing.assert_array_equal(cells == 100, trinary(estimate.map.values) == 1)
    assert set(np.unique(cells)) == {-1, 0, 100}
    final = estimate.trajectory_final
    for name, path in (("final", final), ("online", estimate.trajectory), ("dead_reckoning", estimate.dead_reckoning)):
        found = [(each.pose.position.x, each.pose.position.y) for each in last[f"/path/{name}"].poses]
        np.testing.assert_allclose(found, path.poses[:, :2])
    assert last["/loops"].ns == ""
    stamps = np.array(sorted(moved["odom"]))
    odometry = se2.interpolate(stamps, np.array([moved["odom"][each] for each in stamps]), final.stamps)
    corrections = np.array([moved["map"][each] for each in sorted(moved["map"])])
    np.testing.assert_allclose(se2.compose(corrections, odometry)[:, :2], final.poses[:, :2], atol=1e-5)
    back = open_recording(file)
    assert back.lidar.ranges[:].tobytes() == simulation.recording.lidar.ranges[:].tobytes()


def test_stamps_that_ros_does_not_hold_are_refused(simulation, run, tmp_path: Path) -> None:
    estimate = run[0]
    early = Trajectory(estimate.trajectory.stamps - 2e9, estimate.trajectory.poses)
    with pytest.raises(InputError, match="expected 0 to"):
        write_result_bag(tmp_path / "result.mcap", replace(estimate, trajectory=early), simulation.recording)
    assert not list(tmp_path.iterdir())


def test_replay_writes_it_where_it_is_asked_for(simulated_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["--preset", "paper", "--set", "particles=3", "--no-figures", "--mcap"]
    assert main.run(["replay", str(simulated_folder), "--out", str(out), *options]) == 0
    assert "result.mcap" in (out / ".moteslam").read_text()
    assert main.run(["replay", str(simulated_folder), "--out", str(out), "--force", *options[:-1]]) == 0
    assert not (out / "result.mcap").exists()
