"""moteslam as a node of ROS 2: /scan and /odom in, /map and the transform map -> odom out.

    ros2 run, or: python examples/ros2_node.py

It needs rclpy, tf2_ros and the messages of a sourced ROS 2; the tests have only stand-ins for these. The lidar's mount
is that of the robot file you name; its angles and reach are taken from the first scan.
"""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.node import Node
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
        self.create_subscription(LaserScan, "scan", self.logged(self.on_scan), 10)
        self.create_subscription(Odometry, "odom", self.logged(self.on_odometry), 50)
        self.maps, self.transforms = self.create_publisher(OccupancyGrid, "map", 1), TransformBroadcaster(self)
        self.create_timer(2.0, self.publish_map)

    def logged(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        """A message that cannot be used is logged, and left out."""

        def told(message: Any) -> None:
            try:
                take(message)
            except moteslam.MoteslamError as error:
                self.get_logger().warning(str(error))

        return told

    def on_scan(self, scan: LaserScan) -> None:
        if self.slam is None:
            figures = {"beams": len(scan.ranges), "angle_min": scan.angle_min, "angle_increment": scan.angle_increment}
            figures |= {"range_min": scan.range_min, "range_max": scan.range_max, "rate": 1 / max(scan.scan_time, 0.01)}
            figures["time_increment"] = scan.time_increment
            self.slam = moteslam.OnlineSlam(self.platform.with_(lidar=figures))
        ranges = np.array(scan.ranges, np.float32)
        ranges[ranges >= scan.range_max] = np.inf
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
        drawn = self.slam.map
        sent = OccupancyGrid()
        sent.header.frame_id, sent.info.resolution = "map", drawn.cell_size
        sent.info.height, sent.info.width = drawn.values.shape
        sent.info.origin.position.x, sent.info.origin.position.y = drawn.origin[:2]
        known = np.where(drawn.values > 0, 100, 0)
        sent.data = np.where(drawn.values == 0, -1, known).astype(np.int8).ravel().tolist()
        self.maps.publish(sent)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Slam(moteslam.load_platform(sys.argv[1] if len(sys.argv) > 1 else "turtlebot3")))
