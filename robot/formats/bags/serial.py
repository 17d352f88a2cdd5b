"""Messages of plain values as bytes, by the message definitions that rosbags brings for ROS 1 and ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np

from moteslam.robot.formats.bags.choice import TRANSFORMS
from moteslam.robot.formats.bags.events import Values

_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms\n"
"""The definition of tf2_msgs/TFMessage, which a store of types may lack."""

_ARRAYS = {"float32": np.float32, "float64": np.float64, "uint8": np.uint8}


class Serialiser:
    """Makes messages of one ROS.

    Args:
        ros1: as of ROS 1 (Noetic), else of ROS 2 (Humble).
    """

    def __init__(self, *, ros1: bool) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._ros1 = ros1
        self.store: Any = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if full_name(TRANSFORMS[0]) not in self.store.types:
            self.store.register(get_types_from_msg(_TRANSFORMS, full_name(TRANSFORMS[0])))
        self._fields: dict[str, dict[str, Any]] = {}

    def bytes_of(self, kind: str, values: Values) -> bytes:
        """A message."""
        name = full_name(kind)
        message = self._message(name, values)
        return bytes(
            self.store.serialize_ros1(message, name) if self._ros1 else self.store.serialize_cdr(message, name)
        )

    def _message(self, name: str, values: Values) -> Any:
        made = {}
        for field, (how, what) in self.store.fielddefs[name][1]:
            value = values.get(field)
            made[field] = 0 if field == "seq" and value is None else self._value(how.name, what, value)
        return self.store.types[name](**made)

    def _value(self, how: str, what: Any, value: Any) -> Any:
        """A field's value: a number or text, a message, or an array of either."""
        if how == "BASE":
            return value
        if how == "NAME":
            return self._message(what, value)
        (inner, element) = what[0]
        if inner.name == "NAME":
            return [self._message(element, one) for one in value]
        base = element[0]
        return value if base not in _ARRAYS else np.asarray(value, _ARRAYS[base])


def full_name(kind: str) -> str:
    """The type's name as ROS 2 has it."""
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}"
