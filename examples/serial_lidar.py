"""A lidar on a serial port, carried by hand or driven, to a map: SLAMTEC's RPLIDAR A1, without odometry.

    pip install pyserial; python examples/serial_lidar.py /dev/ttyUSB0 [FOLDER]

Ctrl-C ends it and draws the map. It needs the device, and is not run by the tests. The bytes are those of SLAMTEC's
"RPLIDAR interface protocol": after A5 20 the device sends five bytes a reading.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import serial

import moteslam
from moteslam.eval.cli.main import script

BEAMS = 360


def scans(port: str) -> Iterator[tuple[float, np.ndarray]]:
    """The stamp of the first beam [s] and the ranges of each turn, counterclockwise from behind."""
    with serial.Serial(port, 115200, timeout=2) as device:
        device.dtr = False  # starts the motor
        device.write(b"\xa5\x20")
        if device.read(7)[:2] != b"\xa5\x5a":
            raise SystemExit(f"{port}: no answer of an RPLIDAR")
        stamp, ranges = time.time(), np.full(BEAMS, np.nan, np.float32)
        reading = device.read(5)
        while len(reading) == 5:
            start, quality = reading[0] & 1, reading[0] >> 2
            if start == reading[0] >> 1 & 1 or not reading[1] & 1:
                reading = reading[1:] + device.read(1)  # out of step: the two lowest bits are each other's inverse
                continue
            if start:
                if np.isfinite(ranges).sum() > BEAMS // 2:  # the first turn is not complete
                    yield stamp, ranges
                stamp, ranges = time.time(), np.full(BEAMS, np.nan, np.float32)
            degrees = (reading[1] >> 1 | reading[2] << 7) / 64  # clockwise from ahead
            metres = (reading[3] | reading[4] << 8) / 4000
            ranges[round(180 - degrees) % BEAMS] = metres if quality and metres else np.nan
            reading = device.read(5)
    raise SystemExit(f"{port}: no reading for two seconds")


def main(port: str, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    robot = moteslam.load_platform("rplidar_a1")
    figures = {"beams": BEAMS, "angle_min": -np.pi, "angle_increment": 2 * np.pi / BEAMS, "time_increment": 0.0}
    robot = robot.with_(lidar={**figures, "x": 0.0, "y": 0.0, "yaw": 0.0})
    slam = moteslam.OnlineSlam(robot, patience=0.0)
    try:
        for stamp, ranges in scans(port):
            if update := slam.add_scan(ranges, stamp):
                print(f"x {update.pose[0]:.2f} m, y {update.pose[1]:.2f} m, {update.state.name.lower()}")
    except KeyboardInterrupt:
        slam.finish()
    drawn = slam.map
    plt.imshow(drawn.values, origin="lower", extent=drawn.extent, cmap="gray_r", vmin=-4, vmax=4)
    plt.savefig(folder / "serial_lidar.png", dpi=100)


if __name__ == "__main__":
    script(main)
