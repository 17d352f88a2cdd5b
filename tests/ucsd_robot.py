"""The parts of the UCSD robot, which has them all."""

from moteslam.robot.platforms import UCSD

assert UCSD.wheels is not None
assert UCSD.encoders is not None
assert UCSD.imu is not None
assert UCSD.camera is not None
assert UCSD.camera.sensor is not None
WHEELS, ENCODERS, IMU, CAMERA, KINECT = UCSD.wheels, UCSD.encoders, UCSD.imu, UCSD.camera, UCSD.camera.sensor
