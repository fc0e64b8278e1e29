"""A small process that stops a robot when its driver no longer can: it has died, or it hangs.

It needs no module of the project, so that it starts at once.
"""

import os
import select
import struct
import subprocess
import sys
import time
from contextlib import suppress

# An order: s until the robot must be stopped, unless another order comes; 0: it stands.
_ORDER = struct.Struct("d")
END_TIMEOUT_S = 3.0
WRITE_TIMEOUT_S = 1.0


class StopGuard:
    """Watches over one open port.

    It stands outside the module's session and has none of its marks. The supervisor kills what a dead module
    leaves behind, and would kill the guard before it has written the stop. It ends when its orders end.

    Args:
        descriptor: the open port's; the guard writes to the same port.
        stop: bytes that stop the robot.
    """

    def __init__(self, descriptor: int, stop: bytes) -> None:
        # Isolated, and without site packages: it starts within some 20 ms.
        command = [sys.executable, "-I", "-S", __file__, str(descriptor), stop.hex()]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("ROBBIE_")}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, pass_fds=[descriptor], start_new_session=True, env=environment
        )
        assert self._process.stdin is not None
        self._orders = self._process.stdin.fileno()

    def allow(self, valid_for_s: float) -> None:
        """Let the robot move for this time; 0: it stands."""
        with suppress(OSError):
            os.write(self._orders, _ORDER.pack(valid_for_s))

    def close(self) -> None:
        """End the guard. It stops the robot, as at every end."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def watch(orders: int, port: int, stop: bytes) -> None:
    """Stop the robot whenever an order expires, and at the end of the orders."""
    until_s: float | None = None
    while True:
        wait_s = None if until_s is None else max(0.0, until_s - time.monotonic())
        if select.select([orders], [], [], wait_s)[0]:
            data = os.read(orders, 64 * _ORDER.size)
            if not data:
                break
            (valid_for_s,) = _ORDER.unpack(data[-_ORDER.size :])
            until_s = time.monotonic() + valid_for_s if valid_for_s > 0 else None
        else:
            _write(port, stop)
            until_s = None
    _write(port, stop)


def _write(port: int, data: bytes) -> None:
    # The port may have been pulled out, or accept nothing.
    with suppress(OSError):
        if select.select([], [port], [], WRITE_TIMEOUT_S)[1]:
            os.write(port, data)


if __name__ == "__main__":
    watch(0, int(sys.argv[1]), bytes.fromhex(sys.argv[2]))
