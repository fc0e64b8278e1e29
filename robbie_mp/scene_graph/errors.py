"""What can be wrong with a scene graph, or with a question to it."""

from collections.abc import Iterable

from robbie_mp.errors import RobbieError
from robbie_mp.profile.problem import Problem
from robbie_mp.suggest import did_you_mean


class SceneGraphError(RobbieError):
    """Any error of a scene graph."""


class UnknownNode(SceneGraphError, LookupError):
    """There is no node, or no joint, of this name; the text names near ones.

    Args:
        text: what is missing.
        name: the name that was asked for.
        known: all that there are.
    """

    def __init__(self, text: str, name: str = "", known: Iterable[str] = ()) -> None:
        super().__init__(text)
        self.name = name
        self._known = tuple(known)

    def __str__(self) -> str:
        """Return the text; near names are looked for only now, since that takes long and is seldom read."""
        return f"{self.args[0]}{did_you_mean(self.name, self._known)}"


class NeverPlaced(SceneGraphError, LookupError):
    """A node that moves has not been placed yet: no message has come for it, or none of its joint."""


class Disconnected(SceneGraphError, LookupError):
    """Two nodes have no common ancestor, so neither lies in the frame of the other."""


class TooOld(SceneGraphError, ValueError):
    """The time lies before everything that is remembered of a node; `by_s` says how much."""

    def __init__(self, text: str, by_s: float) -> None:
        super().__init__(text)
        self.by_s = by_s


class TooNew(SceneGraphError, ValueError):
    """The time lies after everything that is known of a node; `by_s` says how much.

    Example scenarios:
      - the odometry of this moment is still on its way: ask again after the next message, or for no time,
        which means the newest that is known of both nodes
    """

    def __init__(self, text: str, by_s: float) -> None:
        super().__init__(text)
        self.by_s = by_s


class NotMovable(SceneGraphError, TypeError):
    """A node or joint was to be moved in a way that its kind does not have."""


class NotAPose(SceneGraphError, ValueError):
    """Numbers that are no pose or joint position: not finite, or a quaternion that is not of length 1."""


class DuplicateNode(SceneGraphError, ValueError):
    """Two nodes, or two joints, have the same name; in one graph every name is there once."""


class MissingParent(SceneGraphError, LookupError):
    """A node hangs on a node that does not exist, or a joint follows one that does not."""


class NodeCycle(SceneGraphError, ValueError):
    """A node is its own ancestor."""


class BadJoint(SceneGraphError, ValueError):
    """A joint is described in a way that makes no sense, such as an axis without a direction."""


class SceneFileError(SceneGraphError, ValueError):
    """A scene file or URDF cannot be used; the text has one line for each problem, with file and line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))
