"""A module whose camera has pictures as large as those of a real one, which show when they were taken."""

import itertools
import time

import numpy as np

from robbie_mp import Header, Module
from robbie_mp.messages import Image

HEIGHT, WIDTH = 480, 640
PANORAMA = 3 * WIDTH
STEP_PX = 8
SHAPES, NOISE = 240, 6.0
NOISES = 7
"""Number of different noises."""
CODE_BITS = 16
CODE_HEIGHT = WIDTH // CODE_BITS
"""The time code is a row of squares at the top: the machine's monotonic time, ms, lowest bit at the left."""


class MovingCamera(Module):
    """Publishes pictures of a scene that passes by: boxes of all sizes and colours, with a sensor's noise.

    At the top is the time at which each was taken, in black and white, so that a test reads its true age.
    """

    period_s = 0.1
    topic = "camera"

    def setup(self) -> None:
        """Draw the scene."""
        chance = np.random.default_rng(1)
        scene = np.full((HEIGHT, PANORAMA, 3), 110.0)
        for _ in range(SHAPES):
            width, height = chance.integers(8, 160, 2)
            x, y = chance.integers(0, PANORAMA - width), chance.integers(0, HEIGHT - height)
            scene[y : y + height, x : x + width] = chance.uniform(20, 235, 3)
        self.scene = scene.astype(np.int16)
        noise = chance.normal(0.0, NOISE, (NOISES, HEIGHT, WIDTH, 3))
        self.noises = itertools.cycle(np.rint(noise).astype(np.int16))  # another one in each picture
        self.left_px = 0

    def tick(self) -> None:
        """Publish the next picture."""
        self.left_px = (self.left_px + STEP_PX) % (PANORAMA - WIDTH)
        seen = self.scene[:, self.left_px : self.left_px + WIDTH] + next(self.noises)
        pixels = np.clip(seen, 0, 255).astype(np.uint8)
        now_ms = time.monotonic_ns() // 1_000_000
        bits = np.array([255 * (now_ms >> bit & 1) for bit in range(CODE_BITS)], np.uint8)
        pixels[:CODE_HEIGHT] = np.repeat(bits, WIDTH // CODE_BITS)[None, :, None]
        image = Image(
            header=Header(stamp=self.now(), frame_id="camera_optical"),
            height=HEIGHT,
            width=WIDTH,
            encoding="rgb8",
            step=3 * WIDTH,
            data=pixels.ravel(),
        )
        self.publish(image, topic=self.topic)
