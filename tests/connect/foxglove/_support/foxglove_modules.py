"""Modules that Foxglove's server shows in tests."""

import numpy as np

from robbie_mp import Module, setting
from robbie_mp.messages import Image, String


class Sign(Module):
    """Publishes one latched text when it starts."""

    period_s = 60.0

    def tick(self) -> None:
        self.publish(String(data="this way"), topic="sign", latched=True)


class Film(Module):
    """Publishes images."""

    period_s: float = setting(0.02, "between images")
    edge: int = setting(500, "rows and columns of an image")

    def tick(self) -> None:
        data = np.zeros(self.edge * self.edge, np.uint8)
        self.publish(
            Image(height=self.edge, width=self.edge, encoding="mono8", step=self.edge, data=data),
            topic="film",
        )
