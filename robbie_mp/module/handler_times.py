"""The times of a module's handlers, which lockstep may charge to the run's clock."""

import logging
from collections.abc import Sequence
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import private_opener


class HandlerTimesMissing(RobbieError, FileNotFoundError):
    """There are no recorded times of a module's handlers.

    Example scenarios:
      - `clock.charge` names a folder that is not the `handler_times` of an earlier run
      - the earlier run did not have this module
    """


class HandlerTimes:
    """Decides how long each handler has taken by the run's clock, and keeps these times in a file.

    Args:
        file: one line for each message handled: the time in ns. An earlier process of the module may have
            written some.
        recorded: times to use instead of measured ones, in that order; None: use measured ones.
        log: warned when there are no recorded times left.
    """

    def __init__(self, file: Path, recorded: Sequence[int] | None, log: logging.Logger):
        file.parent.mkdir(exist_ok=True)
        self._count = len(read_times(file)) if file.exists() else 0
        self._file = open(file, "a", buffering=1, opener=private_opener)  # noqa: SIM115 - open as long as the module
        self._recorded = recorded
        self._log = log

    def charge(self, measured_ns: int) -> int:
        """Return the time of the handler that has just ended.

        Args:
            measured_ns: how long it took.
        """
        time_ns = measured_ns
        if self._recorded is not None:
            if self._count < len(self._recorded):
                time_ns = self._recorded[self._count]
            elif self._count == len(self._recorded):
                self._log.warning(
                    "the recorded handler times end after %d messages; measured times follow, "
                    "so this run does not repeat the recorded one",
                    self._count,
                )
        self._count += 1
        self._file.write(f"{time_ns}\n")
        return time_ns

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_times(file: Path) -> list[int]:
    """Return the times in a file, in ns; a last line without an end does not count."""
    return [int(line) for line in file.read_text().splitlines(keepends=True) if line.endswith("\n")]


def recorded_times(folder: Path, module: str) -> list[int]:
    """Return the times of a module's handlers in an earlier run, in ns.

    Args:
        folder: the folder `handler_times` of that run's output.
        module: name of the module.

    Raises:
        HandlerTimesMissing: the folder has none of this module.
    """
    file = folder / f"{module}.txt"
    try:
        return read_times(file)
    except (OSError, ValueError) as error:
        raise HandlerTimesMissing(
            f"{file} has no handler times ({error}); clock.charge must name the folder handler_times of "
            "a run with this module, or be `measured`"
        ) from error
