"""What can be wrong with a checkpoint."""

from robbie_mp.errors import RobbieError


class CheckpointTooLarge(RobbieError, ValueError):
    """A state does not fit into what the profile allows a module's checkpoint."""


class UnsupportedState(RobbieError, TypeError):
    """A state contains something other than plain data and numpy arrays.

    Example scenarios:
      - an object of a class, be it an Enum or a named tuple: what comes back would be something else
      - an array of Python objects or of records
    """


class CheckpointDamaged(RobbieError, ValueError):
    """Some bytes are no checkpoint, or no longer the one that was written."""


class CheckpointForeign(RobbieError, ValueError):
    """A file may have been written by somebody else, so that what it says may be forged.

    Example scenarios:
      - it belongs to another user of the machine
      - others may write to it
    """


class CheckpointTooNew(RobbieError, ValueError):
    """A checkpoint was written by a newer version of Robbie-MP."""
