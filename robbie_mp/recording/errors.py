"""What the recording package refuses, and why."""

from robbie_mp.errors import RobbieError


class LogError(RobbieError):
    """The root of the errors of this package."""


class LogUnreadable(LogError, OSError):
    """A log cannot be opened: it is missing, or may not be read."""


class NotALog(LogError, ValueError):
    """What was named is no log; the text says what it seems to be."""


class LogDamaged(LogError, ValueError):
    """Bytes of a log are not what they must be; the text says which, and why."""


class LogLimitExceeded(LogError, ValueError):
    """A log would take more memory than is allowed; the text says what of it, where, and the limit."""


class NotDecodable(LogError, ValueError):
    """Messages of a log are encoded in a way that is not known here, or their schema is missing."""


class LogIncomplete(LogError, BlockingIOError):
    """A log is still being written, so nothing should be done to it yet."""


class LogNotWritten(LogError, OSError):
    """A log cannot be written: it exists already, its folder may not be written, or the disk is full."""


class RepairFailed(LogError, RuntimeError):
    """What a repair has written is not what it should be."""


class BagUnreadable(LogError, ValueError):
    """A bag of ROS, or a message in it, cannot be read."""
