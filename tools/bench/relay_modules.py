"""The least that carries messages from one robot to another: a put, and a publication of what arrives.

They are no link: no header, no books, no classes, nothing that a break or a restart would need.
"""

import time
from typing import Any

from robbie_mp import REQUIRED, Module, setting
from robbie_mp.module.envelope import EncodedMessage
from tools.bench.robbie_modules import Picture, Probe

KEY = "bench/relay"
FULL_S = 0.0005
"""Time between two attempts to publish while there is no room: the network waits meanwhile."""


class Relay(Module):
    """One end of the relay."""

    address: str = setting(REQUIRED, "address of Zenoh")
    topic: str = setting(REQUIRED, "topic of the messages")
    has_array: bool = setting(REQUIRED, "whether they are Pictures, or Probes")
    session: Any
    """Of Zenoh."""

    def open(self, role: str) -> Any:
        """Return a session of Zenoh as plain Zenoh has it; `role` is listen or connect."""
        import zenoh  # noqa: PLC0415 - an extra

        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/shared_memory/enabled", "false")
        config.insert_json5("listen/endpoints", "[]")
        config.insert_json5(f"{role}/endpoints", f'["{self.address}"]')
        return zenoh.open(config)

    def teardown(self) -> None:
        """Close the session."""
        self.session.close()


class Sender(Relay):
    """Puts each message."""

    def setup(self) -> None:
        """Open the session, and subscribe."""
        import zenoh  # noqa: PLC0415 - an extra

        self.session = self.open("listen")
        publisher = self.session.declare_publisher(
            KEY, congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )

        def put(message: EncodedMessage) -> None:
            publisher.put(bytes(message.data))

        self.subscribe_encoded("*", put, topic=self.topic)


class Receiver(Relay):
    """Publishes what arrives, in a thread of Zenoh."""

    def setup(self) -> None:
        """Open the session."""
        import zenoh  # noqa: PLC0415 - an extra

        self.session = self.open("connect")
        message_type = Picture if self.has_array else Probe
        name, version, topic = message_type.type_name, message_type.version, self.topic

        def publish(sample: Any) -> None:
            data = sample.payload.to_bytes()
            while not self.publish_encoded(name, version, data, topic=topic):
                time.sleep(FULL_S)

        self.session.declare_subscriber(KEY, zenoh.handlers.Callback(publish, indirect=False))
