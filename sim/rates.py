"""How often things happen in a simulation, and the lidar's shape: those of the UCSD robot."""

from __future__ import annotations

PHYSICS_RATE = 400
"""Physics steps a second."""

TRUTH_RATE = 100
"""True poses a second that are kept."""

LIDAR_RATE = 40.0
"""Scans a second."""

BEAMS = 1081
"""Ranges in a scan."""

ENCODER_RATE = 40.0
"""Readings of the wheel counters a second."""

IMU_RATE = 100.0
"""Readings of the IMU a second."""
