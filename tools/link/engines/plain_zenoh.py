"""Zenoh alone: a publisher for each class, with what Zenoh has for it.

Commands and states go over UDP, best effort; the rest over TCP, with a connection for each range of
priorities. What is reliable has Zenoh's own repetition from a cache.
"""

import json
from typing import Any

import zenoh
from zenoh.ext import (
    CacheConfig,
    MissDetectionConfig,
    RecoveryConfig,
    declare_advanced_publisher,
    declare_advanced_subscriber,
)

from tools.link.engines.side import KEPT, NEWEST_COUNTS, OnMessage

PORT = 7447
WAYS = (
    "udp/{}:7447?rel=0",
    "tcp/{}:7447?rel=1;prio=0-3",
    "tcp/{}:7448?rel=1;prio=4-5",
    "tcp/{}:7449?rel=1;prio=6-7",
)
LEASE_MS = 4000
HEARTBEAT_S = 0.1
RECOVERED = ("urgent", "reliable")
PRIORITIES = {
    "urgent": zenoh.Priority.REAL_TIME,
    "command": zenoh.Priority.REAL_TIME,
    "state": zenoh.Priority.DATA_HIGH,
    "reliable": zenoh.Priority.DATA,
    "bulk": zenoh.Priority.DATA_LOW,
}


class PlainZenoh:
    """An `Engine`."""

    def __init__(self, own: str, other: str, sends: list[str], on_message: OnMessage):
        listens = "bulk" in sends
        settings: dict[str, object] = {
            "mode": "peer",
            "listen/endpoints": [way.format(own) for way in WAYS if listens],
            "connect/endpoints": [way.format(other) for way in WAYS if not listens],
            "connect/timeout_ms": -1,
            "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
            "scouting/multicast/enabled": False,
            "timestamping/enabled": True,
            "transport/shared_memory/enabled": False,  # the two hosts are one machine
            "transport/unicast/max_links": len(WAYS),
            "transport/link/tx/lease": LEASE_MS,
            "transport/link/tx/queue/size/data_low": 1,
        }
        config = zenoh.Config()
        for path, value in settings.items():
            config.insert_json5(path, json.dumps(value))
        self._session = zenoh.open(config)
        self._publishers = {topic: self._publisher(topic) for topic in sends}
        self._subscribers = [self._subscribe(topic, on_message) for topic in KEPT if topic not in sends]

    def wait_for_room(self, topic: str) -> None:
        """Return at once: Zenoh does not say when there is room."""

    def send(self, topic: str, data: bytes) -> None:
        """Send a message, or wait while its queue is full."""
        self._publishers[topic].put(data)

    def _publisher(self, topic: str) -> Any:
        newest_counts = topic in NEWEST_COUNTS
        congestion, reliability = zenoh.CongestionControl, zenoh.Reliability
        how = {
            "priority": PRIORITIES[topic],
            "congestion_control": congestion.DROP if newest_counts else congestion.BLOCK,
            "express": topic != "bulk",
            "reliability": reliability.BEST_EFFORT if newest_counts else reliability.RELIABLE,
        }
        if topic in RECOVERED:
            how |= {"cache": CacheConfig(KEPT[topic]), "publisher_detection": True}
            how["sample_miss_detection"] = MissDetectionConfig(heartbeat=HEARTBEAT_S)
            return declare_advanced_publisher(self._session, f"trial/{topic}", **how)
        return self._session.declare_publisher(f"trial/{topic}", **how)

    def _subscribe(self, topic: str, on_message: OnMessage) -> Any:
        def take(sample: zenoh.Sample) -> None:
            on_message(topic, sample.payload.to_bytes())

        if topic in RECOVERED:
            recovery = RecoveryConfig(heartbeat=True)
            return declare_advanced_subscriber(self._session, f"trial/{topic}", take, recovery=recovery)
        return self._session.declare_subscriber(f"trial/{topic}", take)


ENGINE = PlainZenoh
