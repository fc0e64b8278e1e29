"""A participant of DDS with a few endpoints: it finds other participants, and endpoints that fit its own."""

import contextlib
import math
import secrets
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Final, NamedTuple

import psutil

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.ros2.nodes import NAME_WAIT_S, Admission
from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.endpoints import MAX_PEERS, PartBudget, ReliableReader, ReliableWriter

ANNOUNCED_AT: Final = b"\x00\x01\x00\xc2", b"\x00\x01\x00\xc7"
PUBLICATIONS: Final = b"\x00\x00\x03\xc2", b"\x00\x00\x03\xc7"
SUBSCRIPTIONS: Final = b"\x00\x00\x04\xc2", b"\x00\x00\x04\xc7"
"""Numbers of the built-in writer and reader of each kind."""
PARTICIPANT: Final = b"\x00\x00\x01\xc1"
WRITER_KIND, READER_KIND = 0x03, 0x04
GROUP: Final = "239.255.0.1"
INDICES: Final = 33
"""Participants of one machine that are found without multicast, as CycloneDDS is set up here."""
MAX_PARTICIPANTS: Final = 200
ANNOUNCE_S, LOOK_S, LEASE_S = 2.0, 0.1, 10.0
MAX_LEASE_S: Final = 300.0
"""After this time without a word, a participant has gone, whatever it has said."""
FIRST_ANNOUNCEMENTS: Final = 5
"""Announcements that follow at LOOK_S, so that the first nodes need not wait."""
MAX_DATAGRAM: Final = 65_507
BUFFER_BYTES: Final = 4 << 20
RELIABLE, VOLATILE = 2, 0
DISPOSED: Final = 3
_PORT_BASE, _PER_DOMAIN, _PER_PARTICIPANT, _META, _USER = 7400, 250, 2, 10, 11
_VERSION, _VENDOR, _LEASE, _TOPIC, _TYPE = 0x15, 0x16, 0x02, 0x05, 0x07
_RELIABILITY, _DURABILITY, _USER_DATA, _PARTICIPANT_GUID = 0x1A, 0x1D, 0x2C, 0x50
_DEFAULT_LOCATOR, _META_LOCATOR, _LOCATOR, _BUILTIN = 0x31, 0x32, 0x2F, 0x58
_UDP, LOCATOR_BYTES = 1, 24
_BUILTIN_SET = 0x3F
"""Announces itself, its publications and its subscriptions, and takes those of others."""


class NoInterface(RobbieError, OSError):
    """There is no such network interface, or no free port on it.

    Example scenarios:
      - the interface is spelled wrong, or has no IPv4 address
    """


class RemoteEndpoint(NamedTuple):
    """An endpoint of another participant.

    Attributes:
        guid: participant and number.
        topic: its topic in DDS.
        type_name: its type in DDS.
        is_reliable: whether it is reliable.
        durability: 0: volatile.
        since_s: when it was first heard of.
    """

    guid: bytes
    topic: str
    type_name: str
    is_reliable: bool
    durability: int
    since_s: float

    @property
    def is_writer(self) -> bool:
        """Whether it is a writer, and not a reader."""
        return self.guid[-1] & 0x0F not in (0x04, 0x07)


@dataclass
class _Peer:
    """Another participant."""

    meta: tuple[str, int]
    user: tuple[str, int]
    lease_s: float
    seen_s: float
    since_s: float
    """When it was first heard of; `seen_s`: last."""


@dataclass
class _Own:
    """A writer or reader of this participant, and its topic."""

    endpoint: ReliableWriter | ReliableReader
    topic: str
    type_name: str


@dataclass
class Participant:
    """A participant in a domain; its thread is the only one that receives.

    Args:
        domain: the domain.
        interface: name or IPv4 address of the network interface; `lo` reaches only this machine.
        is_wanted: whether endpoints on a topic matter, also before this side has some there.
        admission: which nodes it speaks with; others do not even hear of its endpoints.
        max_bytes: most bytes of parts of messages that have not come whole.

    Attributes:
        lock: held while its endpoints change.
        others: the endpoints of others that matter, by GUID.
    """

    domain: int
    interface: str
    is_wanted: Callable[[str], bool]
    admission: Admission = field(default_factory=lambda: Admission(["*"], 0))
    max_bytes: int = 1 << 24
    others: dict[bytes, RemoteEndpoint] = field(default_factory=dict)
    on_oversized: Callable[[], None] = lambda: None
    """Called in its thread for each message that is too large."""
    on_unfit: Callable[[RemoteEndpoint, bool], None] = lambda _other, _has_type: None
    """Called once for an endpoint on one of its topics that does not fit, and whether its type does."""
    on_look: Callable[[], None] = lambda: None
    """Called a few times in a second, in the participant's thread."""
    on_malformed: Callable[[], None] = lambda: None
    """Called in that thread after a datagram that is no message of RTPS."""

    def __post_init__(self) -> None:
        self.lock = threading.RLock()
        self.prefix = wire.VENDOR + secrets.token_bytes(wire.PREFIX_BYTES - len(wire.VENDOR))
        self._address = _address_of(self.interface)
        self._is_local = self._address.startswith("127.")
        self._peers: dict[bytes, _Peer] = {}
        self._greeted: set[bytes] = set()
        """Participants that are told of its endpoints."""
        self._unfit: set[bytes] = set()
        self._cut: set[bytes] = set()
        """Participants with endpoints for which there was no room."""
        self._version = 0
        """That of the admission when its endpoints were matched."""
        self._budget = PartBudget(self.max_bytes)
        self._own: list[_Own] = []
        self._number = self._announced = 0
        self._announced_s = -math.inf
        first = self._port(0)
        self._meta, self._user = self._bind(first)
        self._group = None if self._is_local else _multicast(self._address, self._port(0) - _META)
        self._builtin_writers = {
            kind[0]: ReliableWriter(kind[0], self._send_meta, is_latched=True, kept=MAX_PEERS)
            for kind in (PUBLICATIONS, SUBSCRIPTIONS)
        }
        self._builtin_readers = {
            kind[1]: ReliableReader(kind[1], self._send_meta, self._on_endpoint, budget=self._budget)
            for kind in (PUBLICATIONS, SUBSCRIPTIONS)
        }
        self._selector = selectors.DefaultSelector()
        for one in self._sockets():
            self._selector.register(one, selectors.EVENT_READ)
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rtps", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether its thread runs."""
        return self._thread.is_alive()

    # -- endpoints of this side ------------------------------------------------------------------------

    def add_writer(self, topic: str, type_name: str, user_data: bytes) -> ReliableWriter:
        """Add a reliable writer, and announce it."""
        with self.lock:
            writer = ReliableWriter(self._next_entity(WRITER_KIND), self._send_user)
            self._announce_endpoint(_Own(writer, topic, type_name), PUBLICATIONS[0], user_data)
        return writer

    def add_reader(
        self,
        topic: str,
        type_name: str,
        user_data: bytes,
        take: Callable[[wire.Sample], None],
        max_bytes: int,
    ) -> ReliableReader:
        """Add a reliable reader, and announce it."""
        with self.lock:
            entity = self._next_entity(READER_KIND)
            reader = ReliableReader(entity, self._send_user, take, max_bytes, self._budget, self.on_oversized)
            self._announce_endpoint(_Own(reader, topic, type_name), SUBSCRIPTIONS[0], user_data)
        return reader

    def guid(self, endpoint: ReliableWriter | ReliableReader) -> bytes:
        """Return the GUID of an endpoint of this side."""
        return self.prefix + endpoint.entity

    def close(self) -> None:
        """Say goodbye, and end."""
        self._is_closing.set()
        self._thread.join()
        with self.lock:
            disposed = wire.parameter_list([(wire.PID_STATUS_INFO, struct.pack(">I", DISPOSED))])
            key = wire.parameter_list([(_PARTICIPANT_GUID, self.prefix + PARTICIPANT)])
            self._announce(disposed, wire.PARAMETERS + key)
            self._selector.close()
            for one in self._sockets():
                one.close()

    def _next_entity(self, kind: int) -> bytes:
        self._number += 1
        return self._number.to_bytes(3, "big") + bytes([kind])

    def _announce_endpoint(self, own: _Own, builtin: bytes, user_data: bytes) -> None:
        self._own.append(own)
        guid = self.guid(own.endpoint)
        told = [
            (wire.PID_ENDPOINT_GUID, guid),
            (_PARTICIPANT_GUID, self.prefix + PARTICIPANT),
            (wire.PID_KEY_HASH, guid),
            (_TOPIC, wire.text(own.topic)),
            (_TYPE, wire.text(own.type_name)),
            (_RELIABILITY, struct.pack("<IiI", RELIABLE, 0, 0)),
            (_DURABILITY, struct.pack("<I", VOLATILE)),
            (_LOCATOR, self._locator(self._user)),
            (_USER_DATA, struct.pack("<I", len(user_data)) + user_data),
            (_VERSION, wire.MAGIC[4:6]),
            (_VENDOR, wire.VENDOR),
        ]
        self._builtin_writers[builtin].write(wire.PARAMETERS + wire.parameter_list(told))
        for other in self.others.values():
            self._match(own, other)

    # -- others ------------------------------------------------------------------------------------------

    def _sockets(self) -> list[socket.socket]:
        return [one for one in (self._meta, self._user, self._group) if one is not None]

    def _run(self) -> None:
        looked_s = -math.inf
        while not self._is_closing.is_set():
            for key, _ in self._selector.select(LOOK_S):
                self._receive(key.fileobj)  # type: ignore[arg-type]
            if time.monotonic() - looked_s >= LOOK_S:
                looked_s = time.monotonic()
                with self.lock:
                    self._look_after(looked_s)
                self.on_look()

    def _look_after(self, now_s: float) -> None:
        if now_s - self._announced_s >= ANNOUNCE_S or self._announced < FIRST_ANNOUNCEMENTS:
            self._announced_s = now_s
            self._announce(b"", self._announcement())
        for prefix, peer in list(self._peers.items()):
            if now_s - peer.seen_s > peer.lease_s:
                self._forget_peer(prefix)
        for writer in self._writers():
            writer.look_after()
        for reader in self._readers():
            reader.look_after()
        if self._version != self.admission.version:
            self._version = self.admission.version
            self._look_at_admitted()

    def _look_at_admitted(self) -> None:
        """Speak with what was not known to belong to a node that matches."""
        for prefix in [one for one in self._cut if self.admission.admits_one_of(one)]:
            self._ask_again(prefix)
        for prefix in self._peers:
            self._greet(prefix)
        for other in self.others.values():
            for own in self._own:
                self._match(own, other)

    def _receive(self, receiving: socket.socket) -> None:
        try:
            data, source = receiving.recvfrom(MAX_DATAGRAM)
        except OSError:
            return
        self.take(data, source[0])

    def take(self, data: bytes, source: str) -> None:
        """Take a datagram.

        Args:
            data: the datagram.
            source: address of the machine that it came from.
        """
        with self.lock:
            try:
                for one in wire.submessages(data, self.prefix):
                    if one.sender != self.prefix:
                        self._on_submessage(one, source)
            except wire.Wrong:
                self.on_malformed()

    def _on_submessage(self, one: wire.Submessage, source: str) -> None:
        if one.kind in (wire.DATA, wire.DATA_FRAG):
            sample = wire.sample_of(one)
            if sample.writer.endswith(ANNOUNCED_AT[0]):
                self._on_participant(sample, source)
                return
            for reader in self._readers(sample.reader):
                reader.on_sample(sample)
        elif one.kind == wire.HEARTBEAT:
            entity, writer, first, last = wire.heartbeat_of(one)
            for reader in self._readers(entity):
                reader.on_heartbeat(writer, first, last, bool(one.flags & wire.FINAL))
        elif one.kind == wire.GAP:
            entity, writer, start, base, single = wire.gap_of(one)
            for reader in self._readers(entity):
                reader.on_gap(writer, start, base, single)
        elif one.kind == wire.ACKNACK:
            found, entity, base, missing = wire.acknack_of(one)
            for own in self._writers(entity):
                own.on_acknack(found, base, missing)
        elif one.kind == wire.NACK_FRAG:
            found, entity, sequence = wire.nack_frag_of(one)
            for own in self._writers(entity):
                own.on_acknack(found, sequence, [sequence])

    def _on_participant(self, sample: wire.Sample, source: str) -> None:
        prefix = sample.writer[: wire.PREFIX_BYTES]
        if _is_disposed(sample):
            self._forget_peer(prefix)
            return
        told, _ = wire.parameters_of(sample.payload, len(wire.PARAMETERS))
        meta, user = _port_of(told, _META_LOCATOR), _port_of(told, _DEFAULT_LOCATOR)
        said_s = float(struct.unpack_from("<i", told.get(_LEASE, b"\x64\0\0\0"))[0])
        lease_s = min(max(1.0, said_s), MAX_LEASE_S)
        is_new = prefix not in self._peers
        if not meta or not user or (is_new and not self._has_room(prefix)):
            return
        now_s = time.monotonic()
        since_s = now_s if is_new else self._peers[prefix].since_s
        self._peers[prefix] = _Peer((source, meta), (source, user), lease_s, now_s, since_s)
        if is_new:
            self._send_meta(prefix, [self._announcement_part(b"", self._announcement())])
            for kind in (PUBLICATIONS, SUBSCRIPTIONS):
                self._builtin_readers[kind[1]].match(prefix + kind[0])
            self._greet(prefix)

    def _has_room(self, prefix: bytes) -> bool:
        """Whether a further participant may come; one without a node that matches may go for it."""
        if len(self._peers) < MAX_PARTICIPANTS:
            return True
        other = self._leaving(self._peers, self.admission.admits_one_of, prefix)
        if other is not None:
            self._forget_peer(other)
        return other is not None

    def _leaving(
        self,
        known: Mapping[bytes, _Peer] | Mapping[bytes, RemoteEndpoint],
        admits: Callable[[bytes], bool],
        new: bytes,
    ) -> bytes | None:
        """Return the oldest of those without a node that matches, which goes for one that comes; None: none.

        One that has such a node has precedence. For others, only what has had its time to tell a name goes: a
        flood must not drive out those whose names are still to come.
        """
        before_s = math.inf if admits(new) else time.monotonic() - NAME_WAIT_S
        old = takewhile(lambda one: known[one].since_s < before_s, known)
        return next((one for one in old if not admits(one)), None)

    def _greet(self, prefix: bytes) -> None:
        """Tell a participant of the endpoints of this side, if it has a node that matches."""
        if prefix not in self._greeted and self.admission.admits_one_of(prefix):
            self._greeted.add(prefix)
            for kind in (PUBLICATIONS, SUBSCRIPTIONS):
                self._builtin_writers[kind[0]].match(prefix + kind[1])

    def _on_endpoint(self, sample: wire.Sample) -> None:
        told, _ = wire.parameters_of(sample.payload, len(wire.PARAMETERS)) if sample.payload else ({}, 0)
        guid = told.get(wire.PID_ENDPOINT_GUID) or sample.parameters.get(wire.PID_KEY_HASH, b"")
        if len(guid) != wire.GUID_BYTES or guid[: wire.PREFIX_BYTES] != sample.writer[: wire.PREFIX_BYTES]:
            return
        if _is_disposed(sample):
            self._forget(guid)
            return
        topic = wire.text_of(told[_TOPIC]) if _TOPIC in told else ""
        if not self.is_wanted(topic) or (guid not in self.others and not self._has_room_for_endpoint(guid)):
            return
        (reliability,) = struct.unpack_from("<I", told.get(_RELIABILITY, b"\x01\0\0\0"))
        (durability,) = struct.unpack_from("<I", told.get(_DURABILITY, bytes(4)))
        kind = wire.text_of(told.get(_TYPE, wire.text("")))
        since_s = self.others[guid].since_s if guid in self.others else time.monotonic()
        other = RemoteEndpoint(guid, topic, kind, reliability >= RELIABLE, durability, since_s)
        self.others[guid] = other
        for own in self._own:
            self._match(own, other)

    def _has_room_for_endpoint(self, guid: bytes) -> bool:
        """Whether a further endpoint may come; one of a node that does not match may go for it."""
        if len(self.others) < MAX_PEERS:
            return True
        other = self._leaving(self.others, self.admission.admits, guid)
        self._cut.add((guid if other is None else other)[: wire.PREFIX_BYTES])
        if other is not None:
            del self.others[other]
        return other is not None

    def _ask_again(self, prefix: bytes) -> None:
        """Ask a participant for its endpoints from the beginning."""
        self._cut.discard(prefix)
        for kind in (PUBLICATIONS, SUBSCRIPTIONS):
            self._builtin_readers[kind[1]].forget(prefix + kind[0])
            self._builtin_readers[kind[1]].match(prefix + kind[0])

    def _match(self, own: _Own, other: RemoteEndpoint) -> None:
        """Begin to speak with an endpoint if it fits."""
        is_pair = isinstance(own.endpoint, ReliableWriter) != other.is_writer
        if own.topic != other.topic or not is_pair or not self.admission.admits(other.guid):
            return
        has_type = own.type_name == other.type_name
        if has_type and (other.is_reliable if other.is_writer else other.durability == VOLATILE):
            own.endpoint.match(other.guid)
        elif other.guid not in self._unfit and len(self._unfit) < MAX_PEERS:
            self._unfit.add(other.guid)
            self.on_unfit(other, has_type)

    def _forget_peer(self, prefix: bytes) -> None:
        self._peers.pop(prefix, None)
        self._greeted.discard(prefix)
        self._cut.discard(prefix)
        self._forget(prefix)

    def _forget(self, prefix: bytes) -> None:
        for one in [one for one in self.others if one.startswith(prefix)]:
            del self.others[one]
        self._unfit = {one for one in self._unfit if not one.startswith(prefix)}
        for writer in self._writers():
            writer.forget(prefix)
        for reader in self._readers():
            reader.forget(prefix)

    def _writers(self, entity: bytes = b"") -> list[ReliableWriter]:
        own = [one.endpoint for one in self._own if isinstance(one.endpoint, ReliableWriter)]
        return [one for one in (*self._builtin_writers.values(), *own) if not entity or one.entity == entity]

    def _readers(self, entity: bytes = b"") -> list[ReliableReader]:
        own = [one.endpoint for one in self._own if isinstance(one.endpoint, ReliableReader)]
        every = not entity.strip(b"\0")
        return [one for one in (*self._builtin_readers.values(), *own) if every or one.entity == entity]

    # -- datagrams ---------------------------------------------------------------------------------------

    def _announcement(self) -> bytes:
        told = [
            (_VERSION, wire.MAGIC[4:6]),
            (_VENDOR, wire.VENDOR),
            (_PARTICIPANT_GUID, self.prefix + PARTICIPANT),
            (_META_LOCATOR, self._locator(self._meta)),
            (_DEFAULT_LOCATOR, self._locator(self._user)),
            (_LEASE, struct.pack("<iI", int(LEASE_S), 0)),
            (_BUILTIN, struct.pack("<I", _BUILTIN_SET)),
            (_USER_DATA, struct.pack("<I", 10) + b"enclave=/;"),
        ]
        return wire.PARAMETERS + wire.parameter_list(told)

    def _announcement_part(self, parameters: bytes, payload: bytes) -> bytes:
        self._announced += 1
        (part,) = wire.data_parts(bytes(4), ANNOUNCED_AT[0], self._announced, parameters, payload)
        return part

    def _announce(self, parameters: bytes, payload: bytes) -> None:
        data = wire.datagram(
            self.prefix, bytes(wire.PREFIX_BYTES), [self._announcement_part(parameters, payload)]
        )
        targets = [(GROUP, self._port(0) - _META)]
        if self._is_local:
            targets = [(self._address, self._port(index)) for index in range(INDICES)]
        for target in {*targets, *(one.meta for one in self._peers.values())}:
            with contextlib.suppress(OSError):
                self._meta.sendto(data, target)

    def _send_meta(self, prefix: bytes, parts: list[bytes]) -> None:
        if prefix in self._peers:
            self._send(prefix, parts, self._peers[prefix].meta)

    def _send_user(self, prefix: bytes, parts: list[bytes]) -> None:
        if prefix in self._peers:
            self._send(prefix, parts, self._peers[prefix].user)

    def _send(self, prefix: bytes, parts: list[bytes], target: tuple[str, int]) -> None:
        for some in _datagrams(parts):
            with contextlib.suppress(OSError):  # what is lost is sent again
                self._meta.sendto(wire.datagram(self.prefix, prefix, some), target)

    def _port(self, index: int) -> int:
        return _PORT_BASE + _PER_DOMAIN * self.domain + _META + _PER_PARTICIPANT * index

    def _locator(self, bound: socket.socket) -> bytes:
        address = bytes(12) + socket.inet_aton(self._address)
        return struct.pack("<iI", _UDP, bound.getsockname()[1]) + address

    def _bind(self, first: int) -> tuple[socket.socket, socket.socket]:
        for port in range(first, first + _PER_PARTICIPANT * INDICES, _PER_PARTICIPANT):
            bound: list[socket.socket] = []
            try:
                for one in (port, port + _USER - _META):
                    bound.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    bound[-1].setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
                    bound[-1].bind((self._address, one))
                    # Otherwise announcements leave by the interface of the default route.
                    own = socket.inet_aton(self._address)
                    bound[-1].setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
            except OSError:
                for taken in bound:
                    taken.close()
            else:
                return bound[0], bound[1]
        raise NoInterface(f"no free port of DDS on {self.interface!r} in domain {self.domain}")


def _datagrams(parts: list[bytes]) -> Iterator[list[bytes]]:
    waiting = deque(parts)
    while waiting:
        some = [waiting.popleft()]
        while waiting and sum(map(len, some)) + len(waiting[0]) < MAX_DATAGRAM - 100:
            some.append(waiting.popleft())
        yield some


def _address_of(interface: str) -> str:
    for one in psutil.net_if_addrs().get(interface, ()):
        if one.family == socket.AF_INET:
            return str(one.address)
    try:
        socket.inet_aton(interface)
    except OSError as error:
        raise NoInterface(f"there is no network interface {interface!r} with an IPv4 address") from error
    return interface


def _multicast(address: str, port: int) -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    found.bind((GROUP, port))
    member = socket.inet_aton(GROUP) + socket.inet_aton(address)
    found.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    return found


def _is_disposed(sample: wire.Sample) -> bool:
    status = sample.parameters.get(wire.PID_STATUS_INFO, b"")
    return len(status) == 4 and bool(status[3] & DISPOSED)


def _port_of(told: Mapping[int, bytes], number: int) -> int:
    """Return the first UDP port in a list of locators; 0 if there is none. Others are of shared memory."""
    locators = told.get(number, b"")
    for at in range(0, len(locators) - LOCATOR_BYTES + 1, LOCATOR_BYTES):
        kind, port = struct.unpack_from("<iI", locators, at)
        if kind == _UDP and 0 < port < 1 << 16:
            return int(port)
    return 0
