"""SLAM over messages as they come, or over a recording, scan by scan."""

from collections.abc import Callable, Iterable, Iterator
from numbers import Real
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot.inspection import other_units
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording
from moteslam.robot.rgbd import has_images
from moteslam.robot.values import Issue, expect_type, shortened
from moteslam.slam.calibration.calibrate import FEW_PAIRS
from moteslam.slam.calibration.checked import checked
from moteslam.slam.config import METHODS, SlamConfig
from moteslam.slam.core import Core, MakeFilter
from moteslam.slam.estimate import Estimate, with_texture
from moteslam.slam.inputs.camera import BEHIND, DISPARITY, RGB, FloorViews, LiveCamera, checked_image
from moteslam.slam.inputs.inputs import Inputs
from moteslam.slam.inputs.live import FEW, LiveInputs
from moteslam.slam.inputs.odometry_path import odometry_path
from moteslam.slam.inputs.step import steps
from moteslam.slam.inputs.synchronise import synchronise, unknown_mount, warnings
from moteslam.slam.scan_records import Update

STRIDE, LEAST_DRIVEN, LENGTHS = 1.0, 10.0, 1.25
"""Lengths of path and odometry are compared over strides of the first, from the second on [m]; of 160 results of
sound recordings, simulated and real, they differed by less than a tenth."""
EXPLAIN = {
    *("odometry-jumps", "gap", "stale-odometry", "no-odometry", "still-odometry", "wheels-spin", "scans-repeat"),
    *("range-scale", "lost", "searched-for", "not-in-this-map"),
}
"""Codes of what makes lengths differ."""


class OnlineSlam(Core):
    """SLAM while the robot drives: messages are added as they come; ``estimate()`` gives the result so far.

    A scan is taken in once the odometry covers it; one for which none comes within ``patience`` is taken in as one of
    which the motion is not known. ``over`` takes a recording, to the same bytes.

    Args:
        platform: the robot. Messages of scans need the figures of its lidar, counts its wheels; where it has an IMU,
            wheels wait for the gyro.
        config: the preset ``default`` if None.
        seed: from 0 to 2^63 - 1; the same seed gives the same bytes, on one thread and on many.
        method: makes the filter in place of the configuration's method: a class of your own, for one.
        patience: how long a scan waits for odometry [s]: 0 for a robot without any.
        name: of the result.

    Attributes:
        config, seed, name: as given; the name of a recording is its own.
        latest: every update of the latest message, of which the call returns the last.

    Raises:
        ConfigError: the seed is out of bounds.
    """

    def __init__(
        self,
        platform: Platform,
        config: SlamConfig | None = None,
        seed: int = 0,
        *,
        method: MakeFilter | None = None,
        patience: float = 1.0,
        name: str = "online",
    ) -> None:
        expect_type(platform, Platform, "platform", "load_platform(name) reads one")
        super().__init__(config, seed, method, name)
        self._platform, self._patience = platform, patience
        self._recording: Recording | None = None
        self._doubts: tuple[Issue, ...] = ()
        self._about: tuple[int, tuple[Issue, ...]] = 0, ()  # the first messages, and how many scans these were
        self._camera: LiveCamera | None = None
        self._missing = "no camera images" if self._filter.uses_camera else ""
        self._views: FloorViews | None = None
        self.latest: tuple[Update, ...] = ()

    def add_odometry(
        self, stamp: float, pose: ArrayLike | None = None, *, counts: ArrayLike | None = None
    ) -> Update | None:
        """Take in what the base reports: the pose [3] that it integrates, or what its wheels count.

        Args:
            stamp: [s], not below that of the message before.
            counts: [4] since the last, of the front right, front left, rear right and rear left wheel; of a robot
                with two wheels right, left, right, left.

        Returns:
            that of the latest scan that is covered now; None if none is.
        """
        live = self._live("odometry", stamp)
        if (pose is None) is (counts is None):
            given = "neither a pose nor counts" if pose is None else "a pose and counts"
            raise InputError(f"{given}, expected one of them", field="odometry")
        if pose is not None:
            live.hear("odometry", stamp, _numbers(pose, np.float64, 3, "odometry.pose"))
        else:
            live.hear("encoders", stamp, _numbers(counts, np.int64, 4, "odometry.counts"))
        return self._take_in(live)

    def add_imu(self, stamp: float, yaw_rate: float) -> Update | None:
        """Take in the gyro's yaw rate [rad/s], counterclockwise positive; see ``add_odometry``."""
        live = self._live("imu", stamp)
        live.hear("imu", stamp, _numbers([yaw_rate], np.float64, 1, "imu.yaw_rate"))
        return self._take_in(live)

    def add_scan(self, ranges: ArrayLike, stamp: float, odometry: ArrayLike | None = None) -> Update | None:
        """Take in a scan.

        Args:
            ranges: [beams] [m]; infinite, from the lidar's reach on or one of its codes where nothing is within
                reach; NaN or below its least where it measured nothing.
            stamp: of its first beam [s].
            odometry: the base's pose [3] at the scan, where the driver reports one with it.

        Returns:
            that of the latest scan that is covered now; None while it waits for the odometry after it.

        Raises:
            InputError: of a ``file``, the name of the result: units in which nothing is left to make a map of.
        """
        live = self._live("lidar", stamp)
        pose = None if odometry is None else _numbers(odometry, np.float64, 3, "lidar.odometry")
        live.add_scan(_numbers(ranges, np.float32, None, "lidar.ranges"), stamp, pose)
        due = live.beginning.is_due()
        if due or len(live.beginning) == FEW:  # of ranges these are enough, however fast they come
            doubts = other_units(live.beginning.recording(self.name, limited=False))
            self._expect_units(doubts if due else (doubt for doubt in doubts if doubt.code == "range-units"))
        return self._take_in(live)

    def add_image(self, stamp: float, image: ArrayLike) -> Update | None:
        """Take in an image of the robot's RGB-D camera; see ``add_odometry``.

        Those that colour the floor go to a file without a name, and ``estimate`` colours it along the final path.

        Args:
            image: [480, 640, 3] uint8 red, green, blue; or [480, 640] uint16 raw disparities, or depths [m].
        """
        live, mount, texture = self._live("image", stamp), self._platform.camera, self.config.texture
        kind, taken = checked_image(image)
        if mount is None:
            raise ConfigError("none, expected where the camera is", field="platform.camera")
        live.arrives(kind, stamp)
        if self._camera is None or live.messages == 1:
            gap, used = texture.largest_gap, texture.largest_gap if texture.enabled else -1.0  # none is
            self._camera = camera = LiveCamera(texture.interval, used, kept=self._patience + BEHIND)
            if self._filter.uses_camera:
                live.awaited, self._missing = (RGB, DISPARITY), ""
                self._views = FloorViews(lambda: camera.latest, mount, live, largest_gap=gap)
        self._camera.add(kind, stamp, taken)
        return self._take_in(live)

    def estimate(self) -> Estimate:
        """The result of what was taken in until now; of images that were added, with the floor in colours.

        Raises:
            ConfigError: no scan was.
        """
        found = super().estimate()
        if self._camera is None:
            return found
        return with_texture(found, Recording(self.name, self._platform, rgbd=self._camera.used()), interval=0.0)

    @property
    def waiting(self) -> int:
        """How many scans wait for their odometry."""
        return len(self._taken.waiting) if isinstance(self._taken, LiveInputs) else 0

    @property
    def warnings(self) -> tuple[Issue, ...]:
        """What was noticed so far, at no cost; ``estimate`` holds the messages against each other, too, for seconds."""
        return () if self._taken is None else self._warnings(check=False)

    def finish(self) -> Update | None:
        """Take in the scans that still wait: nothing more is to come."""
        if self._camera is not None:
            self._camera.decide(np.inf)
        live = self._taken
        update = self._take_in(live, finish=True) if isinstance(live, LiveInputs) and not self._doubts else None
        self._settle()
        return update

    @classmethod
    def over(
        cls, recording: Recording, config: SlamConfig | None = None, seed: int = 0, *, method: MakeFilter | None = None
    ) -> Self:
        """SLAM over a recording: iterated it gives an ``Update`` a scan, and finishes.

        Raises:
            InputError: the recording has no scans, or no odometry and the method needs one.
        """
        expect_type(recording, Recording, "recording", "open_recording(path) reads one")
        slam = cls(recording.platform, config, seed, method=method, name=recording.name)
        slam._doubts = tuple(other_units(recording))
        slam._expect_units(slam._doubts)
        slam._taken = inputs = synchronise(recording, slam.config.sync, max_range=slam.config.max_range)
        slam._recording = recording
        if inputs.path is None and METHODS[slam.config.method].needs_odometry:
            able = ", ".join(f'"{name}"' for name, method in METHODS.items() if not method.needs_odometry)
            raise InputError(
                f'neither encoders nor odometry, expected one of them with method "{slam.config.method}"; '
                f"method {able} does without",
                file=recording.name,
            )
        if slam._filter.uses_camera:
            stream, mount, gap = recording.rgbd, slam._platform.camera, slam.config.texture.largest_gap
            if stream is None or not has_images(stream):
                slam._missing = "no camera images"
            elif mount is None or not inputs.moves:
                slam._missing = f"no {'camera on the robot' if mount is None else 'odometry between frames and scans'}"
            else:
                slam._views, slam._missing = FloorViews(lambda: stream, mount, inputs, largest_gap=gap), ""
        return slam

    def __len__(self) -> int:
        return 0 if self._taken is None else len(self._taken)

    def __iter__(self) -> Iterator[Update]:
        for step in steps(self._inputs, self._views, thinning=self._filter.thinning, first=self._done):
            yield self._step(step)
        self._settle()

    def _warnings(self, *, check: bool = True) -> tuple[Issue, ...]:
        issues = list(self._doubts)
        if self._recording is not None and not isinstance(self._inputs, LiveInputs):
            issues += warnings(self._recording, self._inputs) if check else ()
        else:
            issues += self._about_messages(self._inputs, check=check)
        if self._missing:
            issues.append(Issue("no-colours", f"colours: {self._missing}: particles are weighed without"))
        if self._views is not None:
            issues += self._views.issues()
        issues += super()._warnings()
        return (*issues, *(() if EXPLAIN & {issue.code for issue in issues} else self._about_lengths()))

    def _about_lengths(self) -> Iterator[Issue]:
        """Where the path is longer or shorter than odometry has it."""
        if not len(self._updates):
            return
        odometry, path = self._inputs.odometry[np.array(self._updates), :2], self._path()[:, :2]
        driven = np.cumsum(np.hypot(*np.diff(odometry, axis=0, prepend=odometry[:1]).T))
        some = np.unique(np.searchsorted(driven, np.arange(0.0, driven[-1], STRIDE)))
        own, by_odometry = (float(np.hypot(*np.diff(one[some], axis=0).T).sum()) for one in (path, odometry))
        if by_odometry > LEAST_DRIVEN and not 1 / LENGTHS < own / by_odometry < LENGTHS:
            text = f"the path is {own:.1f} m long, by odometry {by_odometry:.1f} m: ranges or odometry in another unit"
            text += ", wheels that slip, or scans that are laid wrongly: one of the two is wrong by as much"
            yield Issue("lengths-differ", text)

    def _about_messages(self, live: Inputs, *, check: bool) -> tuple[Issue, ...]:
        """What is told of a recording, of the first messages, and of all of them what was seen as they came."""
        own = (*unknown_mount(self._platform), *live.issues)
        if not isinstance(live, LiveInputs) or not len(beginning := live.beginning):
            return own
        if check and self._about[0] != len(beginning):
            kept, since = beginning.recording(self.name), f"in the first {len(beginning)} scans: " * beginning.full
            about = checked(kept, FEW_PAIRS)[1]
            found = [
                *(() if self._doubts else other_units(beginning.recording(self.name, limited=False))),
                *(() if about is None else about.moves),
            ]
            path = odometry_path(kept, self.config.sync)
            told = {"no-gyro"} & {one.code for one in own}
            found += [one for one in warnings(kept, live, path=path) if one not in own and one.code not in told]
            self._about = len(beginning), tuple(Issue(one.code, since + one.message, one.count) for one in found)
        return (*self._about[1], *own)

    def _live(self, stream: str, stamp: float) -> LiveInputs:
        if not isinstance(stamp, Real):
            kind = "text" if isinstance(stamp, str) else type(stamp).__name__
            raise InputError(f"{shortened(stamp)}, expected a number, not {kind}", field=f"{stream}.stamp")
        if self._taken is None:
            sync, max_range = self.config.sync, self.config.max_range
            self._taken = LiveInputs(self._platform, sync, max_range=max_range, patience=self._patience)
        if not isinstance(self._taken, LiveInputs):
            raise ConfigError("a message after a recording, expected an OnlineSlam of its own", field=stream)
        self._expect_units(self._doubts)
        return self._taken

    def _take_in(self, live: LiveInputs, *, finish: bool = False) -> Update | None:
        updates = list[Update]()
        self._expect_units(live.too_fast)
        while (index := live.take_next(finish=finish)) is not None:
            step = next(steps(live, self._views, thinning=self._filter.thinning, first=index))
            try:
                update = self._step(step)
                updates.append(update)
            except ConfigError:  # a map that grows too large, for one
                self._expect_units(other_units(live.beginning.recording(self.name, limited=False)))
                raise
            if not update.updated:
                live.scans.forget_latest()
        self.latest = tuple(updates)
        return updates[-1] if updates else None

    def _expect_units(self, doubts: Iterable[Issue]) -> None:
        """Refuse units in which nothing is left to make a map of, and each message from then on."""
        for doubt in doubts:
            if doubt.code != "implausible-speed":
                self._doubts = (doubt,)
                raise InputError(doubt.message, file=self.name)


def _numbers(values: Any, dtype: type, count: int | None, field: str) -> NDArray[Any]:
    """A message's numbers as an array of its own, [count] finite ones where that is known."""
    try:
        given = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        given = np.empty((0, 0))
    sound = given.ndim == 1 and count in (None, len(given))
    whole = "whole " * (dtype is np.int64)
    if not sound or (count and not (np.isfinite(given).all() and (not whole or (given.astype(dtype) == given).all()))):
        shown = shortened(given.tolist() if given.ndim == 1 else values)
        shown = f"shape {list(given.shape)}" if given.ndim > 1 and given.size else shown
        raise InputError(f"{shown}, expected {count or 'a list of'} {whole}number{'s' * (count != 1)}", field=field)
    return given.astype(dtype)


def run_slam(
    recording: Recording,
    config: SlamConfig | None = None,
    seed: int = 0,
    watch: Callable[[Update], None] | None = None,
    method: MakeFilter | None = None,
) -> Estimate:
    """Run SLAM over a recording, and colour the floor along the final trajectory where there are images.

    Args:
        recording: with a lidar; with some odometry, too, unless the method does without.
        config: the preset ``default`` if None.
        seed: of all randomness.
        watch: called after every scan.
        method: makes the filter in place of the configuration's method: a class of your own, for one.
    """
    slam = OnlineSlam.over(recording, config, seed, method=method)
    for update in slam:
        if watch is not None:
            watch(update)
    return with_texture(slam.estimate(), recording)
