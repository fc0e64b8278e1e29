"""Real nodes of ROS 2 with its default middleware; see `make ros`."""

import array
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.bench.peers.peer import Peer, Send
from tools.bench.publishing import passing_on
from tools.bench.record import OnMessage
from tools.bench.work import Work

ROS = Path(__file__).parents[3] / ".venv/ros-jazzy"
CONNECT_LIMIT_S = 40.0
NS_PER_S = 1_000_000_000
TEXT_LENGTH = 64
DEPTH = 100


class Rclpy(Peer):
    """Publisher and subscribers are nodes of rclpy, with ROS's default middleware.

    A small message is a String of 64 characters, a large one an Image.
    """

    title = "rclpy"
    how = "rclpy 7.1 with rmw_fastrtps_cpp, reliable, depth 100"
    endings = ("", "")
    """What the topics of the publisher and of the subscribers end in."""

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        """Return the command lines, in ROS's interpreter."""
        return [[str(ROS / "bin/python"), *words] for _, *words in super().commands(name, work, work_file)]

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Wait until somebody subscribes, then yield what publishes."""
        with node_of(work, "publisher") as node:
            publisher = node.create_publisher(kind(work), topic_of(work) + self.endings[0], DEPTH)
            deadline_s = time.monotonic() + CONNECT_LIMIT_S
            wanted = 1 if self.has_relay or work.stages else work.subscribers
            while publisher.get_subscription_count() < wanted and time.monotonic() < deadline_s:
                time.sleep(0.05)
            yield _sender(work, publisher)

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Spin until the last message."""
        ended: list[bool] = []
        with node_of(work, f"subscriber{index}") as node:
            node.create_subscription(
                kind(work),
                topic_of(work) + self.endings[1],
                lambda message: ended.extend([True] * handle(*parts(message))),
                DEPTH,
            )
            spin_until(node, ended)

    def pass_on(self, source: Work, target: Work) -> None:
        """Receive and send with the same node."""
        ended: list[bool] = []
        with node_of(source, f"stage{topic_of(source)[-1]}") as node:
            publisher = node.create_publisher(kind(target), topic_of(target), DEPTH)
            handle = passing_on(source, _sender(target, publisher))
            node.create_subscription(
                kind(source),
                topic_of(source),
                lambda message: ended.extend([True] * handle(*parts(message))),
                DEPTH,
            )
            spin_until(node, ended)

    def clean(self, work: Work) -> None:
        """Remove what killed nodes have left."""
        from robbie_mp.base.linux.fastdds_memory import remove_dead_participants  # noqa: PLC0415

        remove_dead_participants()

    @property
    def why_absent(self) -> str:
        """Whether there are wheels."""
        return "" if (ROS / "done").exists() else "no wheels of ROS 2: `make ros` installs them"

    @property
    def version(self) -> str:
        """The distribution."""
        return "Jazzy"


def topic_of(work: Work) -> str:
    """Return the work's topic as ROS spells topics."""
    return "/" + work.topic.replace("-", "_")


def domain_of(work: Work) -> int:
    """Return a domain that other work hardly has: the folder's name ends in letters that differ."""
    return 100 + sum(work.folder.name.encode()) % 100


def _sender(work: Work, publisher: Any) -> Send:
    data = array.array("B", bytes(work.size_bytes)) if work.has_array else None

    def send(number: int) -> None:
        message = kind(work)()
        if data is None:
            message.data = f"{number} {time.monotonic_ns()}".ljust(TEXT_LENGTH)
        else:
            stamp_ns = time.monotonic_ns()
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS_PER_S)
            message.encoding, message.data = str(number), data
        publisher.publish(message)

    return send


@contextmanager
def node_of(work: Work, name: str) -> Iterator[Any]:
    """Yield a node."""
    os.environ.update(RMW_IMPLEMENTATION="rmw_fastrtps_cpp", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    os.environ["ROS_LOG_DIR"] = str(work.folder)
    import rclpy  # noqa: PLC0415

    rclpy.init(domain_id=domain_of(work))
    node = rclpy.create_node(name)
    yield node
    node.destroy_node()
    rclpy.shutdown()


def spin_until(node: Any, ended: list[bool]) -> None:
    """Handle messages until the last one."""
    import rclpy  # noqa: PLC0415

    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    while not ended:
        executor.spin_once(timeout_sec=1.0)


def kind(work: Work) -> Any:
    """Return the class of the work's messages."""
    from sensor_msgs.msg import Image  # noqa: PLC0415
    from std_msgs.msg import String  # noqa: PLC0415

    return Image if work.has_array else String


def parts(message: Any) -> tuple[int, int]:
    """Return a message's number and stamp."""
    if not hasattr(message, "encoding"):
        number, stamp_ns = message.data.split()
        return int(number), int(stamp_ns)
    stamp = message.header.stamp
    return int(message.encoding), stamp.sec * NS_PER_S + stamp.nanosec


PEER = Rclpy()
