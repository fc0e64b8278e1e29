"""Delays frames: a program that forwards between TAP devices, because many kernels lack the queue `netem`.

It runs in the namespace of the network. Each line of its input is a JSON object with the delay from then on,
and it answers each with a line. It ends with its input.
"""

import contextlib
import fcntl
import heapq
import itertools
import json
import os
import random
import select
import struct
import sys
import time
from collections.abc import Callable, Sequence

TUNSETIFF = 0x400454CA
IFF_TAP = 2
IFF_NO_PI = 0x1000
MAX_FRAME = 1 << 16
MAX_WAITING = 20_000
"""Number of frames under way; others are dropped. With full frames, 100 Mbit/s for 2.4 s."""
KNOT_JITTERS = 4
"""Slowly varying delay: the number of jitters between two random delays, so that frames stay in order."""
MIN_KNOT_S = 1e-3


class Delay:
    """The delay of one direction over time.

    Unless it reorders, the delay varies slowly: it moves from one random value to the next in a time of four
    times the jitter. So it changes by at most half of the time that passes, and no frame overtakes another.

    Args:
        delay_s: mean.
        jitter_s: greatest difference from the mean; all values within are equally likely.
        reorders: give every frame a random delay.
        seed: for the random values.
    """

    def __init__(self, delay_s: float, jitter_s: float, reorders: bool, seed: int = 0):
        self._delay_s, self._jitter_s, self._reorders = delay_s, jitter_s, reorders
        self._random = random.Random(seed)
        self._interval_s = max(MIN_KNOT_S, KNOT_JITTERS * jitter_s)
        self._knot_s = -self._interval_s
        self._from = self._to = self._random.uniform(-1.0, 1.0)

    def at(self, now_s: float) -> float:
        """Return the delay of a frame that comes now, in s; times must not decrease."""
        if not self._jitter_s:
            return self._delay_s
        if self._reorders:
            return self._delay_s + self._jitter_s * self._random.uniform(-1.0, 1.0)
        while (passed := (now_s - self._knot_s) / self._interval_s) >= 1.0:
            skipped = max(1, int(passed) - 1)  # after a long silence, the last two values are enough
            self._knot_s += skipped * self._interval_s
            self._from, self._to = self._to, self._random.uniform(-1.0, 1.0)
        return self._delay_s + self._jitter_s * (self._from + (self._to - self._from) * passed)


class Forwarder:
    """Forwards frames between TAP devices, each after its delay, as a switch that learns addresses.

    Args:
        taps: open devices.
        delay_of: makes the delay of a direction, which the index of a device names.
    """

    def __init__(self, taps: Sequence[int], delay_of: Callable[[int], Delay]):
        self._taps = taps
        self._delays = [delay_of(index) for index in range(len(taps))]
        self._waiting: list[tuple[float, int, bytes, int]] = []
        self._numbers = itertools.count()
        self._learned: dict[bytes, int] = {}

    def set_delay(self, delay_of: Callable[[int], Delay]) -> None:
        """Use other delays for frames that come from now on."""
        self._delays = [delay_of(index) for index in range(len(self._taps))]

    def next_s(self) -> float | None:
        """Return when the next frame is due; None if there is none."""
        return self._waiting[0][0] if self._waiting else None

    def take(self, index: int) -> None:
        """Take the frames that a device has."""
        while True:
            try:
                frame = os.read(self._taps[index], MAX_FRAME)
            except BlockingIOError:
                return
            now_s = time.monotonic()
            self._learned[frame[6:12]] = index
            if len(self._waiting) < MAX_WAITING:
                due_s = now_s + self._delays[index].at(now_s)
                heapq.heappush(self._waiting, (due_s, next(self._numbers), frame, index))

    def give(self) -> None:
        """Send the frames that are due."""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, frame, source = heapq.heappop(self._waiting)
            known = self._learned.get(frame[:6])
            for index in range(len(self._taps)) if known is None else (known,):
                if index != source:
                    with contextlib.suppress(
                        OSError
                    ):  # a device that is full or down loses it, as a radio does
                        os.write(self._taps[index], frame)


def open_tap(name: str) -> int:
    """Make a TAP device, which ends with the descriptor that is returned."""
    fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    fcntl.ioctl(fd, TUNSETIFF, struct.pack("16sH", name.encode(), IFF_TAP | IFF_NO_PI))
    return fd


def main(names: Sequence[str]) -> None:
    """Forward between devices of these names until the input ends."""
    taps = [open_tap(name) for name in names]
    forwarder = Forwarder(taps, lambda index: Delay(0.0, 0.0, False))
    print("ready", flush=True)
    while True:
        due_s = forwarder.next_s()
        timeout_s = None if due_s is None else max(0.0, due_s - time.monotonic())
        readable, _, _ = select.select([0, *taps], [], [], timeout_s)
        forwarder.give()
        for index, tap in enumerate(taps):
            if tap in readable:
                forwarder.take(index)
        if 0 in readable:
            line = sys.stdin.readline()
            if not line:
                return
            wanted = json.loads(line)
            forwarder.set_delay(lambda index, wanted=wanted: Delay(**wanted, seed=index))  # type: ignore[misc]
            print("set", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
