"""moteslam as a node of ROS 2: /scan and /odom in, /map and the transform map -> odom out.

    python examples/ros2_node.py [ROBOT or FILE.toml] [FOLDER]

It needs a sourced ROS 2; the tests have only stand-ins. The lidar's mount is that of the robot, its angles and reach
those of the first scan: scans of other beams are laid on its angles. Ctrl-C writes the result into FOLDER.
"""

import sys
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import LaserScan
from tf2_ros import TransformBroadcaster

import moteslam
from moteslam.robot import se2


def seconds(header: Any) -> float:
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


class Slam(Node):
    def __init__(self, platform: moteslam.Platform) -> None:
        super().__init__("moteslam")
        self.platform, self.slam, self.odometry, self.told = platform, None, {}, set()
        sensor = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)  # which hears reliable ones too
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(LaserScan, "scan", partial(self.hear, self.on_scan), sensor)
        self.create_subscription(Odometry, "odom", partial(self.hear, self.on_odometry), sensor)
        self.maps, self.transforms = self.create_publisher(OccupancyGrid, "map", latched), TransformBroadcaster(self)
        self.create_timer(2.0, self.publish_map)

    def hear(self, take: Any, message: Any) -> None:
        """A message that cannot be used is logged, and left out."""
        try:
            take(message)
        except moteslam.MoteslamError as error:
            self.get_logger().warning(str(error))

    def on_scan(self, scan: LaserScan) -> None:
        ranges = np.array(scan.ranges, np.float32)
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        if self.slam is None:
            keys = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max")
            figures = {key: getattr(scan, key) for key in keys} | {"rate": 1 / max(scan.scan_time, 0.01)}
            robot = self.platform.with_(lidar=figures | {"beams": len(ranges)})
            self.slam, self.angles = moteslam.OnlineSlam(robot), angles
        if len(ranges) not in (0, len(self.angles)):
            off = np.abs(np.angle(np.exp(1j * (self.angles[:, None] - angles))))
            ranges = np.where(off.min(axis=1) < abs(scan.angle_increment), ranges[off.argmin(axis=1)], np.nan)
        self.publish(self.slam.add_scan(ranges, seconds(scan.header)))

    def on_odometry(self, message: Odometry) -> None:
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        pose = (place.x, place.y, 2 * np.arctan2(turn.z, turn.w))
        self.odometry[seconds(message.header)] = pose
        if self.slam is not None:
            self.publish(self.slam.add_odometry(seconds(message.header), pose))

    def publish(self, update: moteslam.Update | None) -> None:
        """Send where the odometry's frame lies in the map."""
        if update is None or not self.odometry:
            return
        stamp = min(self.odometry, key=lambda each: abs(each - update.stamp))
        x, y, theta = se2.compose(update.pose, se2.inverse(self.odometry[stamp])).tolist()
        self.odometry = {each: pose for each, pose in self.odometry.items() if each >= stamp}
        sent = TransformStamped(child_frame_id="odom")
        sent.header.frame_id, sent.header.stamp = "map", self.get_clock().now().to_msg()
        sent.transform.translation.x, sent.transform.translation.y = x, y
        sent.transform.rotation.z, sent.transform.rotation.w = np.sin(theta / 2), np.cos(theta / 2)
        self.transforms.sendTransform(sent)

    def publish_map(self) -> None:
        if self.slam is None or not self.odometry:
            return
        for issue in self.slam.warnings:
            if issue.code not in self.told:
                self.told.add(issue.code)
                self.get_logger().warning(str(issue))
        drawn, sent = self.slam.map, OccupancyGrid()
        sent.header.frame_id, sent.info.resolution = "map", drawn.cell_size
        sent.info.height, sent.info.width = drawn.values.shape
        sent.info.origin.position.x, sent.info.origin.position.y = drawn.origin[:2]
        sent.data = np.select([drawn.values > 0, drawn.values < 0], [100, 0], -1).ravel().tolist()
        self.maps.publish(sent)


def main(robot: str = "turtlebot3", folder: str = "ros2_result") -> None:
    rclpy.init()
    node = Slam((moteslam.read_platform if robot.endswith(".toml") else moteslam.load_platform)(robot))
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    if node.slam is not None:
        node.slam.finish()
        moteslam.write_results(folder, node.slam.estimate(), figures=False)


if __name__ == "__main__":
    main(*remove_ros_args(sys.argv)[1:])
