"""SLAM while the robot drives: messages go in as they come, a pose comes out a scan later.

    python examples/online.py [FOLDER]

Feed ``OnlineSlam`` from your robot's drivers in the same way; ``ros2_node.py`` does it from topics.
"""

from itertools import chain
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from closed_loop import controller

import moteslam
from moteslam.eval.cli.main import script


def feed(slam: moteslam.OnlineSlam, readings: moteslam.Readings) -> list[moteslam.Update]:
    """Hand over what the sensors report, each message once."""
    wheels, imu, scans = readings.encoders, readings.imu, readings.lidar
    updates = chain(
        (slam.add_imu(stamp, rate) for stamp, rate in zip(imu.stamps, imu.angular_velocity[:, 2], strict=True)),
        (slam.add_odometry(stamp, counts=counts) for stamp, counts in zip(wheels.stamps, wheels.counts, strict=True)),
        (slam.add_scan(ranges, stamp) for stamp, ranges in zip(scans.stamps, scans.ranges, strict=True)),
    )
    return [update for update in updates if update is not None]


def main(folder: Path = Path()) -> float:
    """Drive, draw the map at four moments, and return how far the last pose is from the truth [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = moteslam.load_scenario("corridor")
    simulator = moteslam.Simulator(scenario, seed=0)
    slam = moteslam.OnlineSlam(scenario.platform, moteslam.resolve_config("default", ["particles=10"]))
    readings, command, path, behind = simulator.reset(), (0.0, 0.0), [], []
    figure, (top, bottom) = plt.subplots(2, 2, figsize=(12, 6.3), layout="constrained", sharex=True, sharey=True)
    for axes, moment in zip((*top, *bottom), (15, 30, 45, 60), strict=True):
        while simulator.seconds < moment:
            if len(readings.lidar):
                command = controller(readings)
            readings = simulator.step(*command)
            for update in feed(slam, readings):
                path.append(update.pose)
                behind.append(readings.stamp - update.stamp)
        moteslam.draw_map(axes, slam.map)
        axes.plot(*np.array(path)[:, :2].T, color="tab:blue")
        for issue in slam.warnings:
            print(f"after {moment} s: {issue}")
        axes.set(title=f"after {moment} s", aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.label_outer()
    left, right, low, high = slam.map.extent  # the last map, which holds the others: all at one scale
    axes.set(xlim=(left - 0.5, right + 0.5), ylim=(low - 0.5, high + 0.5))
    figure.savefig(folder / "online.png", dpi=100)
    plt.close(figure)
    print(f"{len(path)} poses, {1000 * np.median(behind):.0f} ms after their scans began (median)")
    estimate = slam.estimate()
    error = moteslam.absolute_trajectory_error(estimate.trajectory, simulator.truth).rmse
    print(f"online ATE {100 * error:.1f} cm")
    return error


if __name__ == "__main__":
    script(main)
