"""ROS 1 in Python. Needs a sourced ROS and a running roscore."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tools.bench.peers.peer import Handle, Peer, Send
from tools.bench.work import Work


class Rospy(Peer):
    """TCPROS without Nagle's delay."""

    title = "rospy"
    package = "rospy"
    module = "rospy"
    how = "geometry_msgs/PoseStamped or sensor_msgs/Image over TCPROS, tcp_nodelay; callback"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Publish messages whose header carries number and stamp."""
        import rospy  # noqa: PLC0415

        rospy.init_node("publisher", anonymous=True)
        message_type = _message_type(work)
        publisher = rospy.Publisher(work.topic, message_type, queue_size=1000, tcp_nodelay=True)
        data = b"1" * work.size_bytes

        def send(number: int) -> None:
            message = message_type()
            if work.has_array:
                message.data = data
            message.header.frame_id = f"{number} {time.monotonic_ns()}"
            publisher.publish(message)

        yield send

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait in the main thread while rospy's thread runs the callback."""
        import rospy  # noqa: PLC0415

        ended = threading.Event()

        def on_message(message: Any) -> None:
            number, stamp_ns = map(int, message.header.frame_id.split())
            if handle(number, stamp_ns):
                ended.set()

        rospy.init_node("subscriber", anonymous=True)
        rospy.Subscriber(work.topic, _message_type(work), on_message, tcp_nodelay=True, buff_size=1 << 24)
        ended.wait()


def _message_type(work: Work) -> Any:
    if work.has_array:
        from sensor_msgs.msg import Image  # noqa: PLC0415

        return Image
    from geometry_msgs.msg import PoseStamped  # noqa: PLC0415

    return PoseStamped


PEER = Rospy()
