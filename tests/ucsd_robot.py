"""The parts of the UCSD robot, which has them all."""

from moteslam.robot.platforms import UCSD

WHEELS, ENCODERS, IMU, CAMERA, KINECT = UCSD.wheels, UCSD.encoders, UCSD.imu, UCSD.camera, UCSD.camera.sensor
