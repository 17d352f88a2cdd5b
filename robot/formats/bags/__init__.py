"""ROS bags: ``.bag`` of ROS 1, folders and single files of ROS 2. What is read: ``docs/reference/formats.md``."""
