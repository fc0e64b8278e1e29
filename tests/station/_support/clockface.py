"""Copied into the workspace of tests: a camera whose pictures show the time at which they were taken."""

import time

import numpy as np

from robbie_mp import Header, Module
from robbie_mp.messages import Image, MapMetaData, OccupancyGrid, PoseStamped

BITS, EDGE_PX = 16, 16


class Clockface(Module):
    """Shows the machine's monotonic time in ms as black and white squares, lowest bit first; has a pose."""

    period_s = 0.1

    def tick(self) -> None:
        header = Header(stamp=self.now(), frame_id="map")
        now_ms = time.monotonic_ns() // 1_000_000
        bits = np.array([255 * (now_ms >> bit & 1) for bit in range(BITS)], np.uint8)
        pixels = np.kron(bits[None], np.ones((2 * EDGE_PX, EDGE_PX), np.uint8))
        height, width = pixels.shape
        image = Image(
            header=header, height=height, width=width, encoding="mono8", step=width, data=pixels.ravel()
        )
        self.publish(image, topic="camera")
        self.publish(PoseStamped(header=header), topic="map_pose")
        info = MapMetaData(resolution=0.5, width=8, height=4)
        self.publish(OccupancyGrid(header=header, info=info, data=np.zeros(32, np.int8)))
