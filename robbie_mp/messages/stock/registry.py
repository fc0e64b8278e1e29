"""The stock messages by name."""

from functools import cache, lru_cache

from robbie_mp.messages.errors import UnknownType
from robbie_mp.messages.message import Message
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.stock import (
    foxglove_msgs,
    geometry_msgs,
    link_msgs,
    nav2_msgs,
    nav_msgs,
    playback_msgs,
    profiler_msgs,
    rcl_interfaces,
    robbie_msgs,
    scene_msgs,
    sensor_msgs,
    std_msgs,
    tf2_msgs,
    vision_msgs,
)

_HOMES = (
    foxglove_msgs, geometry_msgs, link_msgs, nav2_msgs, nav_msgs, playback_msgs, profiler_msgs,
    rcl_interfaces, robbie_msgs, scene_msgs, sensor_msgs, std_msgs, tf2_msgs, vision_msgs,
)  # fmt: skip


def stock_registry() -> TypeRegistry:
    """Return a new registry that knows all stock messages."""
    types = (one for home in _HOMES for one in vars(home).values() if isinstance(one, type))
    return TypeRegistry(one for one in types if issubclass(one, Message) and is_stock(one))


_known = cache(stock_registry)


def is_stock(message_type: type[Message]) -> bool:
    """Whether a class is that of a stock message."""
    return message_type.__module__.startswith(f"{__package__}.")  # a registry would take 1 to 4 ms to build


@lru_cache(64)
def class_with_rules(type_name: str, version: int) -> type[Message] | None:
    """Return the class of a stock type that some messages break; None for all other types and versions."""
    try:
        found = _known().get(type_name)
    except UnknownType:
        return None
    return found if found.version == version and found.has_rules else None
