"""What can go wrong when an arm moves."""


class ManipulationError(RuntimeError):
    """An arm cannot do what it should."""


class Unreachable(ManipulationError):
    """No position of the joints brings the hand there, or none without a collision."""


class NoWay(ManipulationError):
    """No way without a collision was found within the limit."""


class WrongArm(ManipulationError, ValueError):
    """A URDF cannot be read, or lacks a joint or frame of the arm."""


class KinematicsMissing(ManipulationError, ImportError):
    """The library for kinematics and collision checks is not installed."""
