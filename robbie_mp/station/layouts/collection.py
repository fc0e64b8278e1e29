"""All layouts of a station: its own, the profile's, and those that operators have changed or saved."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

from robbie_mp.checkpoint.file import write_file
from robbie_mp.station.layouts.layout import Layout, LayoutError, check_layout, places_of

MAX_SAVED = 20
"""Maximum number of layouts that operators have changed or saved."""
MAX_FILE_BYTES = 1 << 18


class LayoutCollection:
    """Layouts by name. Any thread may call its methods.

    Args:
        given: the layouts of station and profile.
        panels: names of the page's panels.
        file: where the operators' layouts are kept.
        log: reports a file that cannot be read or written.
    """

    def __init__(self, given: Mapping[str, Layout], panels: Iterable[str], file: Path, log: logging.Logger):
        self._given = dict(given)
        self._panels = list(panels)
        self._file = file
        self._log = log
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._saved = self._read()

    def _read(self) -> dict[str, Layout]:
        found: dict[str, Layout] = {}
        try:
            with open(self._file, "rb") as file:
                content = json.loads(file.read(MAX_FILE_BYTES))
            for name, places in [*content.items()][:MAX_SAVED]:
                # The profile may have fewer panels than when the layout was saved.
                known = {panel: place for panel, place in places.items() if panel in self._panels}
                if known or not places:
                    found[name] = check_layout(name, known, self._panels)
        except FileNotFoundError:
            pass
        except (OSError, ValueError, AttributeError, TypeError) as error:
            self._log.warning("%s: the saved layouts cannot be used: %s", self._file, error)
        return found

    @property
    def names(self) -> list[str]:
        """Names of all layouts: those of station and profile first."""
        return list(dict.fromkeys([*self._given, *self._saved]))

    def get(self, name: str) -> Layout | None:
        """Return a layout as operators have changed it; None if there is none of this name."""
        return self._saved.get(name, self._given.get(name))

    def is_changed(self, name: str) -> bool:
        """Whether operators have saved this layout."""
        return name in self._saved

    def save(self, name: str, layout: Layout) -> None:
        """Keep a layout, in place of any other of its name.

        Raises:
            LayoutError: the name is not possible, or there are too many layouts.
        """
        checked = check_layout(name, places_of(layout), self._panels)
        with self._lock:
            if name not in self._saved and len(self._saved) >= MAX_SAVED:
                raise LayoutError(f"{MAX_SAVED} layouts are saved already; remove one first")
            self._saved = {**self._saved, name: checked}
        self._keep()

    def forget(self, name: str) -> None:
        """Remove a saved layout. One of station or profile is then as it was at first."""
        with self._lock:
            self._saved = {other: layout for other, layout in self._saved.items() if other != name}
        self._keep()

    def _keep(self) -> None:
        """Write the file in another thread, because the disk may be slow, and pages drive meanwhile."""
        threading.Thread(target=self._write, name="layouts", daemon=True).start()

    def _write(self) -> None:
        with self._writing:
            saved = {name: places_of(layout) for name, layout in self._saved.items()}
            try:
                write_file(self._file, json.dumps(saved, indent=1).encode())
            except OSError as error:
                self._log.warning("%s: the layouts cannot be saved: %s", self._file, error)
