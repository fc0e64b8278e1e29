"""The texts and bytes with which nodes of rmw_zenoh find one another and mark their messages.

Source: https://github.com/ros2/rmw_zenoh/blob/jazzy/docs/design.md (rmw_zenoh 0.2 and later).
"""

import struct
from typing import Final, NamedTuple

from typing_extensions import Self

from robbie_mp.connect.bridge.mapping import Quality
from robbie_mp.connect.ros2.side import NodeName, RosChannel

NODE: Final = "NN"
PUBLISHER: Final = "MP"
SUBSCRIPTION: Final = "MS"
SERVICE: Final = "SS"
CLIENT: Final = "SC"
DEFAULT_DEPTH: Final = 42
"""The depth that rmw_zenoh leaves out."""
GID_BYTES: Final = 16
_ENDPOINT_PARTS = 13
_BEST_EFFORT, _TRANSIENT_LOCAL = "2", "1"
_ATTACHMENT = struct.Struct("<qqB16s")


def data_key(domain: int, channel: RosChannel) -> str:
    """Return the key expression of a topic's messages."""
    return f"{domain}/{channel.name.strip('/')}/{channel.dds_type}/{channel.type_hash}"


def any_type_key(domain: int, channel: RosChannel) -> str:
    """Return the key expression that messages of any type on a topic have."""
    return f"{domain}/{channel.name.strip('/')}/*/*"


def node_token(zenoh_id: str, node: NodeName) -> str:
    """Return the liveliness token of a node: the only one of its session."""
    return f"@ros2_lv/{node.domain}/{zenoh_id}/0/0/{NODE}/{_place(node)}"


def endpoint_token(zenoh_id: str, node: NodeName, entity: int, kind: str, channel: RosChannel) -> str:
    """Return the liveliness token of a publisher, subscription or service.

    Args:
        zenoh_id: the session.
        node: the node that it belongs to.
        entity: its number in the session.
        kind: PUBLISHER, SUBSCRIPTION, SERVICE or CLIENT.
        channel: its topic, or the service with its type.
    """
    parts = (_mangled(channel.name), channel.dds_type, channel.type_hash, quality_text(channel.quality))
    return f"@ros2_lv/{node.domain}/{zenoh_id}/0/{entity}/{kind}/{_place(node)}/{'/'.join(parts)}"


class EndpointToken(NamedTuple):
    """What the token of an endpoint says.

    Attributes:
        session: the Zenoh session.
        kind: PUBLISHER, SUBSCRIPTION, SERVICE or CLIENT.
        node: the full name of its node.
        name: its topic or service.
    """

    session: str
    kind: str
    node: str
    name: str

    @classmethod
    def decode(cls, token: str) -> Self | None:
        """Return what a token says; None if it is not that of an endpoint."""
        parts = token.split("/")
        if len(parts) != _ENDPOINT_PARTS or parts[5] == NODE:
            return None
        namespace = parts[7].replace("%", "/").rstrip("/")
        return cls(parts[2], parts[5], f"{namespace}/{parts[8]}", parts[9].replace("%", "/"))


def any_token(domain: int) -> str:
    """Return the key expression of all tokens of a domain."""
    return f"@ros2_lv/{domain}/**"


def quality_text(quality: Quality) -> str:
    """Return a quality of service as it stands in tokens; what is rmw_zenoh's default stays empty."""
    reliability = "" if quality.is_reliable else _BEST_EFFORT
    durability = _TRANSIENT_LOCAL if quality.is_latched else ""
    depth = "" if quality.depth == DEFAULT_DEPTH else str(quality.depth)
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def gid(token: str) -> bytes:
    """Return an endpoint's number, which others compute from its token: its XXH3 hash of 128 bits."""
    import xxhash  # noqa: PLC0415 - an extra

    number: int = xxhash.xxh3_128_intdigest(token.encode())
    return number.to_bytes(GID_BYTES, "little")


class Attachment(NamedTuple):
    """The attachment of rmw_zenoh to each message; nodes drop messages without it.

    The response of a service has the number and the client of its request.

    Attributes:
        sequence: number of the message or request, of its publisher or client; the first is 1.
        sent_ns: when it was sent: ns since 1970.
        gid: the publisher or client.
    """

    sequence: int
    sent_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """Return its 33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.sent_ns, GID_BYTES, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> Self | None:
        """Return what 33 bytes mean; None if they are no attachment."""
        if len(data) != _ATTACHMENT.size:
            return None
        sequence, sent_ns, length, publisher = _ATTACHMENT.unpack(data)
        return cls(sequence, sent_ns, publisher) if length == GID_BYTES else None


def _place(node: NodeName) -> str:
    """Return enclave, namespace and name."""
    return f"%/{_mangled(node.namespace)}/{node.name}"


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"
