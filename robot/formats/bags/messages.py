"""Messages of ROS: their types, decoded from a bag, and made of plain values to be written to one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

SECOND = 1_000_000_000
"""Nanoseconds."""
_ARRAYS = {"float32": np.float32, "float64": np.float64, "uint8": np.uint8}

Values = dict[str, Any]
"""A message: numbers, texts, arrays, tables of these and lists of tables, by the names of its fields; the others are 0
or empty."""


@dataclass(frozen=True, eq=False)
class Event:
    """A message of a topic and type at the time of its header [ns]; a latched one reaches those who come later."""

    time: int
    topic: str
    kind: str
    values: Values
    latched: bool = False


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of ROS before 2012."""
    return name.lstrip("/")


def full_name(kind: str) -> str:
    """The type's name as ROS 2 has it."""
    return kind.replace("/", "/msg/", 1)


@cache
def store(*, ros1: bool) -> Any:
    """The message definitions that rosbags brings for ROS 1 (Noetic) or ROS 2 (Humble), with those of tf."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    made = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        if name not in made.types:
            made.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", name))
    return made


@cache
def decoder(*, ros1: bool) -> Callable[[bytes, str], Any]:
    """What makes a message of bytes and its type, and a ValueError of whatever rosbags stumbles over."""
    read = store(ros1=ros1).deserialize_ros1 if ros1 else store(ros1=ros1).deserialize_cdr

    def decode(data: bytes, kind: str) -> Any:
        try:
            return read(data, full_name(kind))
        except Exception as error:
            raise ValueError(" ".join(str(error).split())[:200] or "cut short") from error

    return decode


def seconds(nanoseconds: NDArray[np.int64]) -> NDArray[np.float64]:
    """Stamps [s], each the float64 nearest to it but for one rounding more."""
    return nanoseconds // SECOND + (nanoseconds % SECOND) / SECOND


def nanoseconds(stamps: NDArray[np.float64]) -> NDArray[np.int64]:
    """Stamps [s] as whole nanoseconds, rounded half to even.

    From 2^23 s on (97 days: all of Unix time) float64 is coarser than a nanosecond, and they read back bit for bit;
    below it to within half a nanosecond.
    """
    whole = np.floor(stamps)
    return whole.astype(np.int64) * SECOND + np.rint((stamps - whole) * SECOND).astype(np.int64)


def header(time: int, frame: str) -> Values:
    """A header of a time [ns] and a frame."""
    return {"stamp": stamp(time), "frame_id": frame}


def stamp(time: int) -> Values:
    """A time [ns] as messages hold it."""
    return {"sec": time // SECOND, "nanosec": time % SECOND}


def transform(time: int, parent: str, child: str, place: tuple[float, float, float], turn: Values) -> Values:
    """A ``geometry_msgs/TransformStamped``."""
    moved = {"translation": vector(*place), "rotation": turn}
    return {"header": header(time, parent), "child_frame_id": child, "transform": moved}


def vector(x: float, y: float, z: float) -> Values:
    """A ``geometry_msgs/Vector3`` or ``Point``."""
    return {"x": x, "y": y, "z": z}


def turned(yaw: float) -> Values:
    """The quaternion of a turn about z [rad]."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def write_events(writer: Any, events: Iterator[Event], *, ros1: bool, received: Iterator[int] | None = None) -> None:
    """Write messages, each topic's connection before its first; ``received`` [ns] where that is not their own time."""
    types = store(ros1=ros1)
    connections: dict[str, Any] = {}
    for event in events:
        name = full_name(event.kind)
        if event.topic not in connections:
            latched = _latched(ros1=ros1) if event.latched else {}
            connections[event.topic] = writer.add_connection(event.topic, name, typestore=types, **latched)
        time = event.time if received is None else next(received)
        message = _message(types, name, event.values)
        data = types.serialize_ros1(message, name) if ros1 else types.serialize_cdr(message, name)
        writer.write(connections[event.topic], time, bytes(data))


def _message(types: Any, name: str, values: Values) -> Any:
    made = {}
    for field, (how, what) in types.fielddefs[name][1]:
        value: Any = values.get(field)
        if how.name == "NAME":
            value = _message(types, what, value or {})
        elif how.name == "BASE" and value is None:
            value = "" if what[0] == "string" else 0
        elif how.name != "BASE":  # an array of messages or of numbers
            (inner, element), size = what
            if inner.name == "NAME":
                value = [_message(types, element, one) for one in value or ()]
            elif element[0] in _ARRAYS:
                value = np.asarray(np.zeros(size) if value is None else value, _ARRAYS[element[0]])
        made[field] = value
    return types.types[name](**made)


def _latched(*, ros1: bool) -> dict[str, Any]:
    """What makes a connection keep its last message for those who come later."""
    if ros1:
        return {"latching": 1}
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    reliable, local = QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    forever, live = QosTime(2147483647, 4294967295), QosLiveliness.AUTOMATIC
    profile = Qos(QosHistory.KEEP_LAST, 1, reliable, local, forever, forever, live, forever, False)
    return {"offered_qos_profiles": [profile]}
