"""A peer whose clock jumps, or whose beats lie: no command that is stale drives the robot because of it."""

from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp import ModuleHarness
from robbie_mp.connect.link.header import Beat, ChannelId, DataHeader, ReceivedPacket, pack
from robbie_mp.connect.link.module import Link
from robbie_mp.connect.link.peer import BEAT_NS, Peer
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, open_session
from robbie_mp.messages import DriveCommand, Duration

S = 1_000_000_000
HOUR_NS = 3600 * S
SESSION = 77
MANUAL = ChannelId(DriveCommand.type_name, DriveCommand.version, "manual")
COMMAND = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220_000_000)).encode()
TIMES = st.one_of(
    st.sampled_from([-(1 << 63), -1, 0, 1, (1 << 63) - 1]), st.integers(-(1 << 63), (1 << 63) - 1)
)


@pytest.fixture(scope="module", autouse=True)
def zenoh_has_started() -> None:
    """Zenoh keeps some descriptors until the process ends; have it open them before any test looks."""
    open_session(Endpoints()).close()


class Anna:
    """An operator with a clock of her own; what she sends arrives at once, or as late as a test says."""

    def __init__(self, harness: ModuleHarness[Link]):
        self.harness, self.link = harness, harness.module
        self.ahead_ns = 5 * HOUR_NS
        self.sequence = 0

    @property
    def peer(self) -> Peer:
        """How the robot's link sees her."""
        peer = self.link.node.meet("anna")
        assert peer is not None
        return peer

    @property
    def now_ns(self) -> int:
        """The robot's clock."""
        return self.harness.clock.monotonic_ns()

    def beat(self, sent_ns: int | None = None, received_ns: int | None = None) -> None:
        """Answer the robot's newest beat, with true times by her clock or with others."""
        hers_ns = self.now_ns + self.ahead_ns
        sent_ns = hers_ns if sent_ns is None else sent_ns
        received_ns = hers_ns if received_ns is None else received_ns
        asked_ns = self.peer._beats_sent[-1] if self.peer._beats_sent else 0
        self._arrive(Beat("anna", SESSION, self.link.node.session, sent_ns, asked_ns, received_ns))

    def beat_without_answer(self) -> None:
        """Say only that she lives."""
        self._arrive(Beat("anna", SESSION, self.link.node.session, 0, 0, 0))

    def drives(self, age_s: float, stamp_ns: int | None = None) -> bool:
        """Whether a command is obeyed that was sent so long ago, and stamped by her clock of now."""
        before = len(self._commands)
        stamp_ns = self.now_ns + self.ahead_ns - round(age_s * 1e9) if stamp_ns is None else stamp_ns
        self.sequence += 1
        one, size = self.sequence, len(COMMAND)
        header = DataHeader(
            "anna", TrafficClass.COMMAND, 0, 0, SESSION, self.link.node.session, one, one, one, 0, size,
            stamp_ns, 0, MANUAL, size,
        )  # fmt: skip
        self._arrive(header, COMMAND)
        return len(self._commands) > before

    @property
    def _commands(self) -> list[object]:
        return [one for one in self.harness.published_encoded if one.type_name == DriveCommand.type_name]

    def _arrive(self, packet: Beat | DataHeader, payload: bytes = b"") -> None:
        self.link.node.take(ReceivedPacket("anna", pack(packet), payload, self.now_ns, is_datagram=True))

    def pass_time(self, seconds: float = 0.1) -> None:
        """Let the robot's link send a beat."""
        self.harness.advance(seconds)


@pytest.fixture
def anna() -> Iterator[Anna]:
    accept = {"anna": ["DriveCommand manual"]}
    with ModuleHarness(Link, {"robot": "red", "listen": [], "accept": accept, "robots": ["anna"]}) as harness:
        harness.advance(1.0)
        anna = Anna(harness)
        anna.beat()
        yield anna


def test_fresh_commands_are_obeyed_and_stale_ones_are_not(anna: Anna) -> None:
    assert anna.drives(0.05)
    assert not anna.drives(0.35)
    assert not anna.drives(5.0)


@pytest.mark.parametrize("jump_s", [-3600, -10, -2, 2, 10, 3600])
@pytest.mark.parametrize("age_s", [0.5, 1.0, 60.0])
def test_no_stale_command_is_obeyed_after_one_of_the_two_clocks_has_jumped(
    anna: Anna, jump_s: int, age_s: float
) -> None:
    """As after a pause of a virtual machine, or a suspend, in which the robot's clock stood still."""
    assert anna.drives(0.0)
    anna.ahead_ns += jump_s * S
    assert not anna.drives(age_s)
    anna.pass_time()
    anna.beat()  # tells the jump
    assert not anna.drives(age_s)
    assert anna.drives(0.0)


@pytest.mark.parametrize("received_ns", [0, -1, -(1 << 63), (1 << 63) - 1], ids=str)
def test_no_stale_command_is_obeyed_while_every_other_beat_lies(anna: Anna, received_ns: int) -> None:
    for number in range(10):
        anna.pass_time()
        if number % 2:
            anna.beat()
            assert anna.drives(0.0)
        else:
            anna.beat(received_ns, received_ns)
            assert not anna.drives(0.0)  # nobody knows how old it is
        assert not any(anna.drives(age_s) for age_s in (0.35, 1.0, 100.0))


def test_clock_that_no_beat_tells_about_is_believed_for_a_few_minutes_only(anna: Anna) -> None:
    for _ in range(31):
        anna.pass_time(10.0)
        anna.beat_without_answer()
    assert not anna.drives(0.0)


def test_no_times_in_beats_raise_or_become_a_round_trip_that_cannot_be(anna: Anna) -> None:
    @settings(max_examples=100)
    @given(TIMES, TIMES, TIMES)
    def check(sent_ns: int, received_ns: int, stamp_ns: int) -> None:
        anna.pass_time(0.01)
        anna.beat(sent_ns, received_ns)
        anna.drives(0.0, stamp_ns)
        assert 0 <= (anna.peer.clock.round_trip_ns or 0) <= 64 * BEAT_NS
        anna.link.link_state(anna.now_ns).encode()

    check()
    anna.pass_time()
    anna.beat()
    assert anna.drives(0.0)
    assert not anna.drives(0.35)
