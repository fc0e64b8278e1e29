"""Copied into the workspace of tests: a camera that sees one picture all the time."""

from pathlib import Path

import numpy as np

from robbie_mp import Header, Module, Time
from robbie_mp.messages import Image


class PrintCamera(Module):
    """Publishes the picture in the file beside it.

    All images have the same stamp. So what is seen in one counts as seen now, however busy the machine is.
    """

    period_s = 0.2

    def setup(self) -> None:
        self.pixels = np.load(Path(__file__).with_name("scene.npy"))

    def tick(self) -> None:
        height, width, _ = self.pixels.shape
        self.publish(
            Image(
                header=Header(stamp=Time(sec=100), frame_id="camera_optical"),
                height=height,
                width=width,
                encoding="rgb8",
                step=3 * width,
                data=self.pixels.ravel(),
            ),
            topic="camera",
        )
