"""Frames of the robot that have other names on the other side of a bridge.

The setting `frames` of a bridge says what the robot's frames are called there:

    frames:
      map: map
      "*": red/{frame}

A frame that is named counts before `*`, which stands for all others. The bridge renames what leaves the
robot, and turns the names back in what comes in: in each text field called `frame_id` or `child_frame_id`,
at any depth. An empty name stays empty. What comes in loses the slash that ROS 1 puts before a name, so
that `/map` and `map` are one frame.
"""

import re
from collections.abc import Mapping

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.bridge.mapping import MappingError
from robbie_mp.messages import Message
from robbie_mp.messages.frames import Rename, renamer, unchanged, without_slash

MAX_FRAMES = 256
"""Most frames that a profile may rename one by one."""
OTHERS, FRAME = "*", "{frame}"
FRAME_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")


class ForeignFrame(RobbieError, ValueError):
    """A message is about a frame of the other side that the robot does not have.

    Example: the robot's `map` is `red/map` in ROS, and a goal comes in the frame `map`.
    """


class FrameMap:
    """What the robot's frames are called on the other side of a bridge.

        frames = FrameMap({"map": "map", "*": "red/{frame}"})
        assert frames.name_there("base_link") == "red/base_link"
        assert frames.name_here("red/base_link") == "base_link"

    Args:
        frames: the setting of that name; see above. Empty: every frame has the same name on both sides.

    Raises:
        MappingError: a line is wrong, or two frames would have the same name.
    """

    def __init__(self, frames: Mapping[str, str]):
        self._there = {name: other for name, other in frames.items() if name != OTHERS}
        self._here = {other: name for name, other in self._there.items()}
        self._before, self._after = "", ""
        self._has_others = OTHERS in frames
        problems = [
            f"{name!r}: {other!r} is not a name of a frame, such as 'red/map'"
            for name, other in self._there.items()
            if not (FRAME_NAME.fullmatch(name) and FRAME_NAME.fullmatch(other))
        ]
        if len(frames) > MAX_FRAMES:
            problems.append(f"there are {len(frames)} frames; at most {MAX_FRAMES} can be named")
        if len(self._here) < len(self._there):
            problems.append("two frames have the same name on the other side")
        if self._has_others:
            self._before, found, self._after = frames[OTHERS].partition(FRAME)
            if not (found and FRAME_NAME.fullmatch(frames[OTHERS].replace(FRAME, "frame", 1))):
                problems.append(f"'*': expected a name with {FRAME} in it, such as 'red/{FRAME}'")
        if problems:
            raise MappingError("\n".join(problems))
        for name, other in self._there.items():
            same = self._unwrapped(other)
            if same is not None and same not in self._there:
                raise MappingError(f"{name!r}: with '*', {same!r} is called {other!r}, too")

    def name_there(self, name: str) -> str:
        """Return what a frame of the robot is called on the other side."""
        found = self._there.get(name)
        if found is None:
            return f"{self._before}{name}{self._after}" if self._has_others and name else name
        return found

    def name_here(self, name: str) -> str:
        """Return what the robot calls a frame of the other side.

        Raises:
            ForeignFrame: it means another frame on the robot, or with `*` none.
        """
        name = without_slash(name)
        found = self._here.get(name) or self._unwrapped(name)
        if found is not None and self.name_there(found) == name:
            return found
        if name and (self._has_others or name in self._there):
            raise ForeignFrame(f"the robot has no frame that is called {name!r:.80} there")
        return name

    def outward(self, message_type: type[Message]) -> Rename:
        """Return what renames the frames in messages of a type that leave the robot."""
        return renamer(message_type, self.name_there) if self._renames else unchanged

    def inward(self, message_type: type[Message]) -> Rename:
        """Return what renames the frames in messages of a type that come in.

        It raises a `MessageError` if the bytes are no such message, and `ForeignFrame` as `name_here` does.
        """
        return renamer(message_type, self.name_here, is_only_slash=not self._renames)

    @property
    def _renames(self) -> bool:
        return bool(self._there or self._has_others)

    def _unwrapped(self, name: str) -> str | None:
        """Return the robot's name of what `*` has renamed; None: it has not."""
        inside = name.removeprefix(self._before).removesuffix(self._after)
        fits = self._has_others and inside and len(inside) == len(name) - len(self._before + self._after)
        return inside if fits else None
