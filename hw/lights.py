"""The interface of lights."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence


class LightsError(ValueError):
    """There is no light of this name, or a brightness is no number from 0 to 1."""


class Lights(ABC):
    """Lights that are switched together with a device, each by its name.

    Args:
        names: names of the lights.
    """

    can_dim = True
    """Whether a light can be anything between dark and full; otherwise each brightness above 0 is full."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)

    @abstractmethod
    def shine(self, name: str, brightness: float) -> float:
        """Let a light shine from now on.

        Args:
            name: the light.
            brightness: from 0 (dark) to 1 (full).

        Returns:
            How bright it shines.

        Raises:
            LightsError: there is no such light, or the brightness is out of range.
            DeviceSilent: the device is not connected.
        """

    @abstractmethod
    def read(self) -> tuple[float, ...] | None:
        """Return the brightness of each light; None while it is not known."""

    def check(self, name: str, brightness: float) -> int:
        """Return a light's place among the names.

        Raises:
            LightsError: as in `shine`.
        """
        if name not in self.names:
            raise LightsError(f"there is no light {name!r}; there are: {', '.join(self.names)}")
        if not (math.isfinite(brightness) and 0.0 <= brightness <= 1.0):
            raise LightsError(f"brightness of a light must be a number from 0 to 1, not {brightness}")
        return self.names.index(name)
