"""Errors of scene graphs and of queries."""

from collections.abc import Iterable

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.problem import Problem
from robbie_mp.base.suggest import did_you_mean


class SceneGraphError(RobbieError):
    """Any error of a scene graph."""


class UnknownNode(SceneGraphError, LookupError):
    """There is no node, or no joint, of this name; the text suggests similar names.

    Args:
        text: what is missing.
        name: the requested name.
        known: all known names.
    """

    def __init__(self, text: str, name: str = "", known: Iterable[str] = ()) -> None:
        super().__init__(text)
        self.name = name
        self._known = tuple(known)

    def __str__(self) -> str:
        """Return the text; similar names are searched only now, because that is slow and rarely needed."""
        return f"{self.args[0]}{did_you_mean(self.name, self._known)}"


class NeverPlaced(SceneGraphError, LookupError):
    """A moving node has no pose yet: no message about it or its joint has arrived."""


class Disconnected(SceneGraphError, LookupError):
    """Two nodes have no common ancestor, so neither has a pose in the frame of the other."""


class TooOld(SceneGraphError, ValueError):
    """The time lies before the remembered history of a node, by `by_s`."""

    def __init__(self, text: str, by_s: float) -> None:
        super().__init__(text)
        self.by_s = by_s


class TooNew(SceneGraphError, ValueError):
    """The time lies after the newest known pose of a node, by `by_s`.

    Example scenarios:
      - the odometry of this moment has not arrived yet: query again after the next message, or without a
        time, which means the newest time known for both nodes
    """

    def __init__(self, text: str, by_s: float) -> None:
        super().__init__(text)
        self.by_s = by_s


class NotMovable(SceneGraphError, TypeError):
    """A node or joint cannot be moved in this way, because of its type."""


class NotAPose(SceneGraphError, ValueError):
    """Numbers are not a pose or joint position: not finite, or a quaternion whose length is not 1."""


class DuplicateNode(SceneGraphError, ValueError):
    """Two nodes, or two joints, of a graph have the same name."""


class MissingParent(SceneGraphError, LookupError):
    """The parent of a node, or the joint that another joint follows, does not exist."""


class NodeCycle(SceneGraphError, ValueError):
    """A node is its own ancestor."""


class BadJoint(SceneGraphError, ValueError):
    """The description of a joint is invalid, such as an axis without a direction."""


class SceneFileError(SceneGraphError, ValueError):
    """A scene file or URDF cannot be used; the text has a line for each problem, with file and line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))
