"""One moment of the run, from a clip of the black box: what the cameras saw, and where the robot was."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robbie_mp.attached.views.image_pixels import NoPicture
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import CompressedImage, ControlState, Image, Message, MessageError, PoseStamped
from robbie_mp.station.fleet.topics import is_preview
from robbie_mp.station.page.control_bar import MODES
from robbie_mp.station.page.control_bar import TOPIC as CONTROL_TOPIC
from robbie_mp.station.watch.pictures import encode_image

if TYPE_CHECKING:
    from pathlib import Path

    from robbie_mp.logs.recording.reader import LogChannel, LoggedMessage

POSE_TOPIC = "map_pose"
AFTER_S = 1.0
"""Without a picture before the moment, one that was taken this soon after it is shown."""
MAX_PIXELS, QUALITY = 640, 70
TYPES: tuple[type[Message], ...] = (Image, CompressedImage, PoseStamped, ControlState)


@dataclass(frozen=True)
class Moment:
    """What was the case at one time."""

    time_s: float
    """Seconds since 1970."""
    text: str
    """What happened."""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    """JPEG or PNG, by the names of the cameras."""
    pose: tuple[float, float, float] | None = None
    """x, y (m) and heading (rad) on the map; None: not in the clip."""
    mode: str = ""
    """Who controlled the robot: AUTO, MANUAL or HOLD; '': not in the clip."""
    early_s: Mapping[str, float] = field(default_factory=dict)
    """How long before the moment each picture was taken."""


def read_moment(clip: Path, time_s: float, text: str) -> Moment:
    """Read a moment of a clip. This takes a while.

    Args:
        clip: its folder.
        time_s: the moment, seconds since 1970.
        text: what happened.

    Raises:
        OSError: the clip cannot be read, or newer ones have taken its place.
        LogError: it is damaged.
    """
    newest: dict[tuple[str, str], LoggedMessage] = {}
    at_ns, end_ns = round(time_s * 1e9), round((time_s + AFTER_S) * 1e9)
    with open_log(clip) as log:
        channels = [one for one in log.channels if _is_wanted(one)]
        for message in log.messages(end_ns=end_ns, channels=channels):
            key = (message.channel.type_name, message.channel.topic)
            if message.time_ns <= at_ns or key not in newest:
                newest[key] = message
        for one in log.newest_latched(at_ns, channels):
            newest.setdefault((one.channel.type_name, one.channel.topic), one)
    pictures: dict[str, bytes] = {}
    early_s: dict[str, float] = {}
    for kind in (Image, CompressedImage):
        for (type_name, topic), message in sorted(newest.items(), key=lambda item: item[0]):
            name = topic or "image"
            if type_name == kind.type_name and name not in pictures:
                try:
                    pictures[name] = encode_image(kind.decode(message.data), MAX_PIXELS, QUALITY).data
                    early_s[name] = (at_ns - message.time_ns) / 1e9
                except (NoPicture, MessageError):
                    continue
    pose = newest.get((PoseStamped.type_name, POSE_TOPIC))
    control = newest.get((ControlState.type_name, CONTROL_TOPIC))
    return Moment(
        time_s,
        text,
        pictures,
        None if pose is None else _planar(PoseStamped.decode(pose.data)),
        "" if control is None else MODES.get(ControlState.decode(control.data).mode, ""),
        early_s,
    )


def _is_wanted(channel: LogChannel) -> bool:
    kind = next((one for one in TYPES if one.type_name == channel.type_name), None)
    if kind is None or kind.version != channel.version or is_preview(channel.topic):
        return False
    wanted = {PoseStamped: POSE_TOPIC, ControlState: CONTROL_TOPIC}.get(kind)
    return wanted is None or channel.topic == wanted


def _planar(stamped: PoseStamped) -> tuple[float, float, float] | None:
    """Return x, y and heading; None if the robot did not know where it was."""
    at, heading = stamped.pose.position, stamped.pose.orientation.yaw
    return (at.x, at.y, heading) if all(map(math.isfinite, (at.x, at.y, heading))) else None
