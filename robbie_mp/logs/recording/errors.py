"""The errors of the recording package."""

from robbie_mp.base.errors import RobbieError


class LogError(RobbieError):
    """The base class of this package's errors."""


class LogUnreadable(LogError, OSError):
    """A log cannot be opened: it is missing, or you may not read it."""


class NotALog(LogError, ValueError):
    """The named file is not a log; the text says what it seems to be."""


class LogDamaged(LogError, ValueError):
    """Bytes of a log are wrong; the text says which, and why."""


class LogLimitExceeded(LogError, ValueError):
    """A log would take more memory than allowed; the text says what needs it, where, and the limit."""


class NotDecodable(LogError, ValueError):
    """Messages of a log have an unknown encoding, or their schema is missing."""


class LogIncomplete(LogError, BlockingIOError):
    """A log is still being written, so you should not change it yet."""


class LogNotWritten(LogError, OSError):
    """A log cannot be written: it exists already, you may not write to its folder, or the disk is full."""


class RepairFailed(LogError, RuntimeError):
    """The result of a repair is wrong."""


class BagUnreadable(LogError, ValueError):
    """A ROS bag, or a message in it, cannot be read."""
