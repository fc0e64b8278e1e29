"""The ways between two links: a stream, and datagrams past it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.connect.link.wire import Endpoints, ways


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
    assert ways(Endpoints(datagrams=True), [address]) == expected


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
