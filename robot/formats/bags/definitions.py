"""Messages of ROS: their definitions, which rosbags brings, and a message out of its bytes."""

from functools import cache
from typing import Any

from moteslam.robot.formats.bags.storage import MAX_CHUNK, ZSTD, Topic, unpack


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
def is_readable(topic: Topic) -> bool:
    """Whether a topic's messages are of the definition that is read here, as far as the bag says."""
    known, name = store(ros1=True), full_name(topic.kind)
    return topic.digest in ("", "*") or (name in known.types and topic.digest == known.generate_msgdef(name)[1])


def decode(topic: Topic, data: bytes) -> Any:
    """A message; a ValueError where it is not what its type says."""
    try:
        if not is_readable(topic):
            raise ValueError("another definition")
        if topic.encoding == "ros1":
            return store(ros1=True).deserialize_ros1(data, full_name(topic.kind))
        if data.startswith(ZSTD):
            data = unpack(data, "zstd", MAX_CHUNK)
        return store(ros1=False).deserialize_cdr(data, full_name(topic.kind))
    except Exception as error:  # whatever rosbags stumbles over
        raise ValueError(" ".join(str(error).split())[:200] or "cut short") from error
