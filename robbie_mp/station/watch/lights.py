"""The robot's lights, for all panels that switch them."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, NamedTuple

from robbie_mp.messages import LightsState

if TYPE_CHECKING:
    from robbie_mp.station.watch.latest import MessageSource

MAX_MODULES, MAX_LIGHTS = 8, 32
SILENT_S = 2.0
"""A brightness that is older than this is not known any more."""


class LightId(NamedTuple):
    """One light of the robot."""

    module: str
    """The topic of its state and its requests, which is the name of the module that switches it."""
    name: str
    can_dim: bool


class LightsWatch:
    """What modules say of their lights.

    Args:
        station: source of the messages.
    """

    def __init__(self, station: MessageSource):
        self._station = station
        self._told: dict[str, tuple[LightsState, float]] = {}
        """The newest state of each module, and when it came."""
        station.hear(LightsState, self._on_state)

    def _on_state(self, state: LightsState) -> None:
        module = self._station.envelope.topic
        if module in self._told or len(self._told) < MAX_MODULES:
            # A new dictionary, because the pages read the old one meanwhile.
            self._told = {**self._told, module: (state, time.monotonic())}

    def shown(self) -> dict[LightId, float | None]:
        """Return the lights and their brightness, from 0 to 1; None while it is not known."""
        found: dict[LightId, float | None] = {}
        now_s = time.monotonic()
        for module, (state, told_s) in self._told.items():
            for name, brightness in zip(state.name, state.brightness.tolist(), strict=False):
                if len(found) < MAX_LIGHTS:
                    is_known = now_s - told_s <= SILENT_S and math.isfinite(brightness)
                    found[LightId(module, name, state.can_dim)] = brightness if is_known else None
        return found

    @property
    def are_on(self) -> bool:
        """Whether any light is known to shine."""
        return any(self.shown().values())
