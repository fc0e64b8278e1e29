"""The ways between two links: streams, and datagrams past them."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from robbie_mp.connect.link.header import Beat
from robbie_mp.connect.link.wire import (
    STREAMS,
    Endpoints,
    InboxLimits,
    Wire,
    has_quic,
    open_session,
    ways,
)
from tests._support.robot import wait_until
from tests.connect.link._support.garbling_relay import garbling_relay
from tools.robot import free_port


@pytest.fixture(scope="module", autouse=True)
def linked() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Two sessions that are linked. Zenoh keeps descriptors that it opens with the first ones."""
    address = [f"tcp/127.0.0.1:{free_port()}"]
    listening = open_session(Endpoints(listen=address, datagrams=True))
    connecting = open_session(Endpoints(connect=address, datagrams=True))
    sessions = (listening, connecting)
    wait_until(lambda: all(len(session.info.links()) == len(STREAMS) + 1 for session in sessions))
    yield listening, connecting
    connecting.close()
    listening.close()


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("tcp/10.0.0.1:7447", ["tcp/10.0.0.1:7447?rel=1", "udp/10.0.0.1:7447?rel=0"]),
        ("tls/10.0.0.1:7447", ["tls/10.0.0.1:7447?rel=1", "quic/10.0.0.1:7447?rel=0"]),
        ("tcp/10.0.0.1:7447#so_sndbuf=65000", ["tcp/10.0.0.1:7447#so_sndbuf=65000"]),
        ("udp/10.0.0.1:7447", ["udp/10.0.0.1:7447"]),
    ],
)
def test_a_stream_has_datagrams_beside_it(address: str, expected: list[str]) -> None:
    assert ways(Endpoints(datagrams=True), [address], listens=True) == expected
    for endpoints in (
        Endpoints(connect=[address], datagrams=True),
        Endpoints(listen=[address], datagrams=True),
    ):
        assert has_quic(endpoints) == address.startswith("tls/")


def test_two_links_have_a_stream_for_each_range_of_priorities_at_one_address(
    linked: tuple[zenoh.Session, zenoh.Session],
) -> None:
    expected = sorted([*((int(one[0]), int(one[-1])) for one in STREAMS), (0, 7)])
    for session in linked:
        assert sorted(link.priorities for link in session.info.links()) == expected


def test_clients_of_a_router_and_links_without_datagrams_have_one_way() -> None:
    for endpoints in (Endpoints(mode="client", datagrams=True), Endpoints()):
        assert ways(endpoints, ["tcp/10.0.0.1:7447"]) == ["tcp/10.0.0.1:7447"]


def test_what_is_declared_in_datagrams_and_lost_is_declared_again_in_a_stream() -> None:
    port = free_port()
    with ExitStack() as opened:

        def wire(robot: str, listen: Sequence[str] = (), connect: Sequence[str] = ()) -> Wire:
            endpoints = Endpoints(listen=listen, connect=connect, datagrams=True)
            one = Wire(robot, 1, endpoints, InboxLimits(1000, 1 << 20), lambda: None)
            opened.callback(one.close)
            return one

        near_port, relay = opened.enter_context(garbling_relay(port))
        red = wire("red", listen=[f"tcp/127.0.0.1:{port}"])
        blue = wire("blue", connect=[f"tcp/127.0.0.1:{near_port}"])
        wait_until(lambda: relay.garbled > 0)
        assert not red._has_new_stream and not blue._has_new_stream
        wait_until(lambda: all(len(one._zenoh.info.links()) == len(STREAMS) + 1 for one in (red, blue)))
        relay.garbles = False
        heard: set[tuple[str, bool]] = set()

        def both_hear_both_ways() -> bool:
            for one, own, other in ((red, "red", "blue"), (blue, "blue", "red")):
                one.look_after(time.monotonic_ns())
                for as_datagram in (True, False):
                    one.send(other, Beat(own, 1, 2, 3, 4, 5), b"", as_datagram=as_datagram)
                heard.update((each.robot, each.is_datagram) for each in one.received())
            return len(heard) == 4

        wait_until(both_hear_both_ways)
        assert "blue" in red.seen() and "red" in blue.seen()


@pytest.mark.slow
def test_a_trusted_robot_cannot_send_under_the_name_of_another_one(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.connect.link._support.impostor", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    heard, seen = json.loads(ended.stdout)
    assert set(heard) == {"blue"}
    assert "green" not in seen
