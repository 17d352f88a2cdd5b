"""Robots in TOML: the bundled ones beside this, and those of files, alone or over what a recording states."""

from dataclasses import dataclass, replace
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Self

import tomli_w

from moteslam.errors import ConfigError
from moteslam.files import write_atomically
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.values import Table, merged, read_toml, validated

FOLDER = Path(__file__).parent

BASE = "base"  # The key of a file that names the bundled robot whose values it changes

_MAY_BE_LEFT_OUT = frozenset({"name", "description", "top_speed", "top_turn_rate", "no_return", "noise", "as_recorded"})
"""By a whole robot: words, limits and codes that not every one has, errors that are not there unless they are given."""

_MOUNT = ("x", "y", "yaw", "time_increment")  # What SLAM knows of where the lidar stands


def _names() -> list[str]:
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def bundled_platforms() -> dict[str, str]:
    """The names of the robots that come with the package, each with a sentence on what it is."""
    return {name: bundled_platform(name).description for name in _names()}


@cache
def bundled_platform(name: str) -> Platform:
    """The bundled robot of that name."""
    if name not in _names():
        expected = f"expected one of {', '.join(_names())}, or a .toml file"
        raise ConfigError(f"no robot of this name, {expected}", field=name)
    return Platform.model_validate({"name": name, **read_toml(FOLDER / f"{name}.toml", "a robot")})


def load_platform(name_or_path: str | PathLike[str]) -> Platform:
    """A whole robot, to be simulated: a bundled one by its name, or that of a TOML file.

    A file has every key but those of ``noise`` and ``as_recorded``, or names the bundled robot whose values it changes
    with ``base``.

    Raises:
        ConfigError: no such robot, not readable, an unknown key, a value out of bounds, or keys that are missing.
    """
    text, path = str(name_or_path), Path(name_or_path)
    if path.suffix != ".toml" and path.name == text:
        return bundled_platform(text)
    return whole_platform({"name": path.stem, **read_toml(path, "a platform.toml")}, file=path)


def whole_platform(table: Table, *, file: str | PathLike[str] | None = None) -> Platform:
    """A robot of a table that leaves nothing out, or names its ``base``; ``file`` is named in errors."""
    table = _over_its_base(table, file)
    platform = validated(Platform, table, file=file)
    keys = [key for key in Platform.model_fields if key not in table]
    if isinstance(lidar := table.get("lidar"), dict):
        keys += [f"lidar.{key}" for key in LidarSpec.model_fields if key not in lidar]
    if missing := ", ".join(key for key in keys if key.rpartition(".")[2] not in _MAY_BE_LEFT_OUT):
        bases = ", ".join(f'"{name}"' for name in _names())
        raise ConfigError(f"{missing} missing, expected a whole robot, or base = one of {bases}", file=file)
    return platform


def read_platform(path: str | PathLike[str], *, base: Platform | None = None) -> Platform:
    """Read a ``platform.toml``.

    Args:
        path: the file; with a key ``base`` it changes the bundled robot of that name.
        base: the robot that it overrides, key by key; a robot of which nothing is known by default.

    Raises:
        ConfigError: not readable, an unknown key, a value out of bounds, or a table that is begun and misses keys that
            the robot below has not.
    """
    return platform_of(read_toml(Path(path), "a platform.toml"), file=path, base=base)


def platform_of(table: Table, *, file: str | PathLike[str], base: Platform | None = None, above: str = "") -> Platform:
    """The robot of the table ``above`` in a file; else as ``read_platform``."""
    table = _over_its_base(table, file, above)
    table = table if base is None else merged(base.model_dump(exclude_unset=True), table)
    return validated(Platform, table, file=file, above=above)


def _over_its_base(table: Table, file: str | PathLike[str] | None, above: str = "") -> Table:
    """The table over the bundled robot that it names, if it names one."""
    if BASE not in table:
        return table
    name, changes = table[BASE], {key: value for key, value in table.items() if key != BASE}
    if name not in _names():
        field = ".".join(filter(None, (above, BASE)))
        raise ConfigError(f"{name!r}, expected one of {', '.join(_names())}", file=file, field=field)
    return merged(platform_table(bundled_platform(name)), changes)


def write_platform(path: str | PathLike[str], platform: Platform) -> None:
    """Write a platform as TOML with every key; it reads back equal, bit for bit, whatever it overrides."""
    write_atomically(path, tomli_w.dumps(platform_table(platform)))


def platform_table(platform: Platform) -> Table:
    """Every key of a platform, ``False`` for what it has not: TOML has no other word for it."""
    return platform.model_dump()


@dataclass(frozen=True)
class GivenRobot:
    """The robot that a caller gives of a recording: complete, as the table of a file that differs from it, or none."""

    platform: Platform | None
    file: Path | None
    table: Table

    @classmethod
    def read(cls, given: Platform | str | PathLike[str] | None) -> Self:
        """What is given; a file is read here, and not again."""
        if given is None or isinstance(given, Platform):
            return cls(given, None, {})
        return cls(None, Path(given), read_toml(given, "a platform.toml"))

    def lidars(self) -> tuple[Self, dict[str, LidarSpec]]:
        """The same without the tables ``[lidars."/topic"]`` of a file, and the mounts that these give, by topic."""
        rest, mounts = dict(self.table), {}
        found = rest.pop("lidars", {})
        for topic, table in found.items() if isinstance(found, dict) else [("", found)]:
            if self.file is None or not isinstance(table, dict) or set(table) - {"x", "y", "z", "yaw"}:
                field = f"lidars.{topic!r}" if topic else "lidars"
                raise ConfigError("expected a table a topic, with x, y, z and yaw", file=self.file, field=field)
            mounts[f"/{topic.lstrip('/')}"] = platform_of({"lidar": table}, file=self.file).lidar
        return replace(self, table=rest), mounts

    @property
    def is_nothing(self) -> bool:
        return self.platform is None and self.file is None

    def over(self, stated: Platform, *, assumed: bool = False) -> Platform:
        """The robot of a recording: the one given, or the file's keys over those that the recording states.

        Where that is ``assumed``, the robot that the format is known for, wheels have to be given completely.
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


UCSD = bundled_platform("ucsd")  # The robot of the UCSD sequences, its origin midway between the axles

CARMEN = Platform(name="carmen")
"""A robot of which a CARMEN log states nothing else: odometry poses and a lidar at its centre."""
