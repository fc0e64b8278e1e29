"""The claim to be a run's operator station: only one can be, or two pages could drive at once."""

import fcntl
from pathlib import Path

from robbie_mp.errors import RobbieError

FILE = "operator-station"


class StationExists(RobbieError, FileExistsError):
    """A run has an operator station already.

    Example scenarios:
      - `robbie gui` attaches to a robot whose profile has one
      - two people attach one each
    """


class StationClaim:
    """Holds the claim until it is closed, or this process dies.

    Args:
        run_folder: the folder of the run.

    Raises:
        StationExists: the run has an operator station.
    """

    def __init__(self, run_folder: Path):
        self._file = (run_folder / FILE).open("a+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.seek(0)
            address = self._file.read() or "it is just starting"
            self._file.close()
            raise StationExists(f"this run has an operator station already: {address}") from None

    def announce(self, address: str) -> None:
        """Tell others where the page is."""
        self._file.seek(0)
        self._file.truncate()
        self._file.write(address)
        self._file.flush()

    def close(self) -> None:
        """Give it up."""
        self._file.close()
