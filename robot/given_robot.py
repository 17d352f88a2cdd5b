"""The robot that a caller gives of a recording: complete, or a file of what differs from the one it states."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from moteslam.errors import ConfigError
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import BASE, platform_of
from moteslam.robot.specs import LidarSpec
from moteslam.robot.tables import Table, read_toml

_MOUNT = ("x", "y", "yaw", "time_increment")
"""What SLAM knows of where the lidar stands."""


@dataclass(frozen=True)
class GivenRobot:
    """A robot, the table of a ``platform.toml``, or nothing.

    Attributes:
        platform: the robot, where it is given itself.
        file: that was read; None without one.
        table: what is in it.
    """

    platform: Platform | None
    file: Path | None
    table: Table

    @classmethod
    def read(cls, given: Platform | str | PathLike[str] | None) -> GivenRobot:
        """What is given; a file is read here, and not again.

        Raises:
            ConfigError: not readable, or not TOML.
        """
        if given is None or isinstance(given, Platform):
            return cls(given, None, {})
        file = Path(given)
        return cls(None, file, read_toml(file, "a platform.toml"))

    def lidars(self) -> tuple[GivenRobot, dict[str, LidarSpec]]:
        """The same without the tables ``[lidars."/topic"]`` of a file, and the mounts that these give, by topic.

        Raises:
            ConfigError: a table that is none, or has other keys than ``x``, ``y``, ``z`` and ``yaw``.
        """
        if self.file is None or "lidars" not in self.table:
            return self, {}
        found, rest = self.table["lidars"], {key: value for key, value in self.table.items() if key != "lidars"}
        mounts = {}
        for topic, table in found.items() if isinstance(found, dict) else [("", found)]:
            field = f"lidars.{topic!r}" if topic else "lidars"
            if not isinstance(table, dict) or set(table) - {"x", "y", "z", "yaw"}:
                raise ConfigError("expected a table a topic, with x, y, z and yaw", file=self.file, field=field)
            name = topic if topic.startswith("/") else f"/{topic}"
            mounts[name] = platform_of({"lidar": table}, file=self.file).lidar
        return replace(self, table=rest), mounts

    @property
    def is_nothing(self) -> bool:
        """Whether neither a robot nor a file is given."""
        return self.platform is None and self.file is None

    def over(self, stated: Platform, *, assumed: bool = False) -> Platform:
        """The robot of a recording: the one given, or the file's keys over those that the recording states.

        Args:
            stated: the robot that the recording states.
            assumed: whether the recording states nothing, and ``stated`` is the robot that its format is known for:
                wheels of another robot then have to be given completely.

        Raises:
            ConfigError: as `read_platform`.
        """
        if self.platform is not None:
            return self.platform
        if self.file is None:
            return stated
        if assumed and isinstance(self.table.get("wheels"), dict) and BASE not in self.table:
            stated = stated.model_copy(update={"wheels": None})
        return platform_of(self.table, file=self.file, base=stated)

    @property
    def leaves_out(self) -> bool:
        """Whether a file names some of what SLAM goes by, wheels and the lidar's mount, and leaves the rest out."""
        lidar = self.table.get("lidar", {})
        named = ["wheels" in self.table, *(isinstance(lidar, dict) and key in lidar for key in _MOUNT)]
        return BASE not in self.table and any(named) and not all(named)

    @property
    def lidar_figures(self) -> Table:
        """What a file gives itself of the lidar's scans: ``angle_min``, ``range_max`` and so on."""
        lidar = self.table.get("lidar")
        return {key: value for key, value in lidar.items() if value is not False} if isinstance(lidar, dict) else {}
