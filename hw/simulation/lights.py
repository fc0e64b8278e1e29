"""Simulated lights."""

from collections.abc import Sequence

from robbie_robots.hw.lights import Lights


class SimulatedLights(Lights):
    """Lights that can be dimmed; they are dark at first.

    Args:
        names: names of the lights.
    """

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__(names)
        self._brightness = [0.0] * len(self.names)

    def shine(self, name: str, brightness: float) -> float:
        """Let a light shine from now on."""
        self._brightness[self.check(name, brightness)] = brightness
        return brightness

    def read(self) -> tuple[float, ...]:
        """Return the brightness of each light."""
        return tuple(self._brightness)
