"""All layouts of a station: its own, the profile's, and those that operators have changed or saved."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from robbie_mp.bus.checkpoint.file import write_file
from robbie_mp.station.page.layouts.layout import Layout, LayoutError, check_layout, places_of

MAX_SAVED = 20
"""Maximum number of layouts that operators have changed or saved, for each shape of page."""
MAX_FILE_BYTES = 1 << 18


WIDE, UPRIGHT = "wide", "upright"
"""The keys in the file: layouts for pages that are wider than high, and for the others."""


class LayoutCollection:
    """Layouts by name: of each, one for wide pages and one for upright ones. Any thread may call its methods.

    A layout that exists only for one shape of page is used for the other, too.

    Args:
        given: the layouts of station and profile.
        panels: names of the page's panels.
        file: where the operators' layouts are kept.
        log: reports a file that cannot be read or written.
        upright: layouts of the same names for pages that are higher than wide.
    """

    def __init__(
        self,
        given: Mapping[str, Layout],
        panels: Iterable[str],
        file: Path,
        log: logging.Logger,
        upright: Mapping[str, Layout] | None = None,
    ):
        self._given = {WIDE: dict(given), UPRIGHT: dict(upright or {})}
        self._panels = list(panels)
        self._file = file
        self._log = log
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._saved = self._read()

    def _read(self) -> dict[str, dict[str, Layout]]:
        try:
            with open(self._file, "rb") as file:
                content = json.loads(file.read(MAX_FILE_BYTES))
            return {shape: self._checked(content[shape]) for shape in (WIDE, UPRIGHT)}
        except FileNotFoundError:
            pass
        except KeyError as error:
            self._log.warning("%s: the saved layouts cannot be used: %s is missing", self._file, error)
        except (OSError, ValueError, AttributeError, TypeError) as error:
            self._log.warning("%s: the saved layouts cannot be used: %s", self._file, error)
        return {WIDE: {}, UPRIGHT: {}}

    def _checked(self, content: Mapping[str, Mapping[str, Any]]) -> dict[str, Layout]:
        found: dict[str, Layout] = {}
        for name, places in [*content.items()][:MAX_SAVED]:
            # The profile may have fewer panels than when the layout was saved.
            known = {panel: place for panel, place in places.items() if panel in self._panels}
            if known or not places:
                found[name] = check_layout(name, known, self._panels)
        return found

    @property
    def names(self) -> list[str]:
        """Names of all layouts: those of station and profile first."""
        return list(dict.fromkeys([*self._given[WIDE], *self._saved[WIDE], *self._saved[UPRIGHT]]))

    def get(self, name: str, *, upright: bool = False) -> Layout | None:
        """Return a layout as operators have changed it; None if there is none of this name."""
        shape, other = (UPRIGHT, WIDE) if upright else (WIDE, UPRIGHT)
        for source in (self._saved[shape], self._given[shape], self._saved[other], self._given[other]):
            if name in source:
                return source[name]
        return None

    def is_changed(self, name: str) -> bool:
        """Whether operators have saved this layout, for one shape of page or both."""
        return any(name in layouts for layouts in self._saved.values())

    def save(self, name: str, layout: Layout, *, upright: bool = False) -> None:
        """Keep a layout for one shape of page, in place of any other of its name.

        Raises:
            LayoutError: the name is not possible, or there are too many layouts.
        """
        checked = check_layout(name, places_of(layout), self._panels)
        shape = UPRIGHT if upright else WIDE
        with self._lock:
            if name not in self._saved[shape] and len(self._saved[shape]) >= MAX_SAVED:
                raise LayoutError(f"{MAX_SAVED} layouts are saved already; remove one first")
            self._saved = {**self._saved, shape: {**self._saved[shape], name: checked}}
        self._keep()

    def forget(self, name: str) -> None:
        """Remove a saved layout. One of station or profile is then as it was at first."""
        with self._lock:
            self._saved = {
                shape: {other: layout for other, layout in layouts.items() if other != name}
                for shape, layouts in self._saved.items()
            }
        self._keep()

    def _keep(self) -> None:
        """Write the file in another thread, because the disk may be slow, and pages drive meanwhile."""
        threading.Thread(target=self._write, name="layouts", daemon=True).start()

    def _write(self) -> None:
        with self._writing:
            saved = {
                shape: {name: places_of(layout) for name, layout in layouts.items()}
                for shape, layouts in self._saved.items()
            }
            try:
                write_file(self._file, json.dumps(saved, indent=1).encode())
            except OSError as error:
                self._log.warning("%s: the layouts cannot be saved: %s", self._file, error)
