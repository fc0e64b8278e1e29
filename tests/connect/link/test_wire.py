"""The ways between two links: streams, and datagrams past them."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from robbie_mp.connect.link.wire import STREAMS, Endpoints, has_quic, open_session, ways
from tests._support.robot import wait_until
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


@pytest.mark.slow
def test_a_trusted_robot_cannot_send_under_the_name_of_another_one(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.connect.link._support.impostor", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    heard, seen = json.loads(ended.stdout)
    assert set(heard) == {"blue"}
    assert "green" not in seen
