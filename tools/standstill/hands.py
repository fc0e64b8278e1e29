"""Programs with which an operator drives; each commands until it is ended.

python -m tools.standstill.hands attached RUN | back RUN | foxglove LINK
"""

import json
import struct
import sys
import threading
import time
from contextlib import suppress

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

import robbie_mp
from robbie_mp import Duration, Header, Module, Time
from robbie_mp.messages import DriveCommand, Twist, Vector3

LINEAR_M_PER_S, ANGULAR_RAD_PER_S = 0.3, 0.3
"""A circle of 1 m, so that the robot stays in the hall."""
PERIOD_S = 0.05
VALID_FOR_S = 0.17
"""As on the operator's page."""


def command(now_ns: int, linear_m_per_s: float = LINEAR_M_PER_S) -> DriveCommand:
    """Return the operator's command."""
    now = Time.from_nanoseconds(now_ns)
    return DriveCommand(
        header=Header(stamp=now),
        linear_m_per_s=linear_m_per_s,
        angular_rad_per_s=ANGULAR_RAD_PER_S,
        valid_for=Duration.from_seconds(VALID_FOR_S),
        based_on=now,
    )


class StandstillHand(Module):
    """Drives from a laptop, over a link."""

    period_s = PERIOD_S

    def tick(self) -> None:
        """Send a command."""
        self.publish(command(self.clock.now_ns()), topic="manual")


def drive_attached(run_id: str, linear_m_per_s: float = LINEAR_M_PER_S) -> None:
    """Command a run on this machine."""
    with robbie_mp.attach(run_id) as run:
        while True:
            run.publish(command(time.time_ns(), linear_m_per_s), topic="manual")
            time.sleep(PERIOD_S)


def back_up_attached(run_id: str) -> None:
    """Have a run on this machine drive backwards."""
    drive_attached(run_id, -LINEAR_M_PER_S)


def drive_by_foxglove(link: str) -> None:
    """Command as the panel Teleop of Foxglove does."""
    twist = Twist(linear=Vector3(x=LINEAR_M_PER_S), angular=Vector3(z=ANGULAR_RAD_PER_S)).encode()
    channel = {"id": 1, "topic": "/cmd_vel", "encoding": "cdr", "schemaName": "geometry_msgs/msg/Twist"}
    while True:  # a server that died comes back
        with suppress(OSError, WebSocketException):
            _drive_while_connected(link, twist, channel)
        time.sleep(PERIOD_S)


def _drive_while_connected(link: str, twist: bytes, channel: dict[str, object]) -> None:
    with connect(link, subprotocols=["foxglove.sdk.v1"], max_size=None, compression=None) as socket:  # type: ignore[list-item]
        threading.Thread(target=lambda: [None for _ in socket], daemon=True).start()
        socket.send(json.dumps({"op": "advertise", "channels": [channel]}))
        while True:
            socket.send(struct.pack("<BI", 1, 1) + twist)
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    if "--help" in sys.argv:
        print(f"usage: {__doc__}")
    else:
        programs = {"attached": drive_attached, "back": back_up_attached, "foxglove": drive_by_foxglove}
        programs[sys.argv[1]](sys.argv[2])
