"""Errors of checkpoints."""

from robbie_mp.base.errors import RobbieError


class CheckpointTooLarge(RobbieError, ValueError):
    """A state exceeds the profile's limit for a module's checkpoint."""


class UnsupportedState(RobbieError, TypeError):
    """A state contains something other than plain data and numpy arrays.

    Example scenarios:
      - an object of a class, even an Enum or a named tuple: it would be restored as something else
      - an array of Python objects or of records
    """


class CheckpointDamaged(RobbieError, ValueError):
    """The data is not a checkpoint, or was damaged after it was written."""


class CheckpointForeign(RobbieError, ValueError):
    """Another user may have written a file, so its content may be forged.

    Example scenarios:
      - it belongs to another user of the machine
      - others may write to it
    """


class CheckpointTooNew(RobbieError, ValueError):
    """A checkpoint was written by a newer version of Robbie-MP."""
