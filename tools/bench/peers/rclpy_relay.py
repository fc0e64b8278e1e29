"""Real nodes of ROS 2 with a relay between: what the bridge is compared with."""

import time
from typing import Any

from tools.bench.peers.rclpy import DEPTH, Rclpy, kind, node_of, parts, spin_until, topic_of
from tools.bench.work import END, Work


class RclpyRelay(Rclpy):
    """Publisher, relay and subscriber are nodes of rclpy."""

    title = "rclpy relay"
    how = f"{Rclpy.how}; a node passes on what it gets"
    endings = ("/before", "/behind")
    has_relay = True

    def relay(self, work: Work) -> None:
        """Pass on until the last message."""
        ended: list[bool] = []
        with node_of(work, "relay") as node:
            source, target = (topic_of(work) + ending for ending in self.endings)
            publisher = node.create_publisher(kind(work), target, DEPTH)

            def on_message(message: Any) -> None:
                publisher.publish(message)
                if parts(message)[0] == END:
                    ended.append(True)

            node.create_subscription(kind(work), source, on_message, DEPTH)
            spin_until(node, ended)
            time.sleep(1.0)  # until the last message has left


PEER = RclpyRelay()
