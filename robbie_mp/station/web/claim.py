"""The claim to be a run's operator station: only one can be, or two pages could drive at once."""

import fcntl
import os
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import private_opener

FILE = "operator-station"


class StationExists(RobbieError, FileExistsError):
    """A run has an operator station already.

    Example scenarios:
      - you run `robbie gui` for a robot whose profile has an operator station
      - two people run `robbie gui` for the same robot
    """


class StationClaim:
    """Holds the claim until it is closed, or this process dies.

    Args:
        run_folder: the folder of the run.

    Raises:
        StationExists: the run has an operator station.
    """

    def __init__(self, run_folder: Path):
        fd = private_opener(str(run_folder / FILE), os.O_RDWR | os.O_CREAT | os.O_APPEND)
        self._file = os.fdopen(fd, "a+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.seek(0)
            address = self._file.read() or "it is just starting"
            self._file.close()
            raise StationExists(
                f"this run has an operator station already: {address}; robbie gui --link shows its link"
            ) from None

    def announce(self, address: str) -> None:
        """Write the page's address for other processes."""
        self._file.seek(0)
        self._file.truncate()
        self._file.write(address)
        self._file.flush()

    def close(self) -> None:
        """Release the claim."""
        self._file.close()
