"""The evaluation of the measurement of the operator's page, and one session."""

import socket
from contextlib import closing

import pytest

from tools.load.operator.__main__ import HEADINGS, row
from tools.load.operator.measure import Session, drawn, measure, own_mb, profile
from tools.load.operator.narrow_link import narrow_link

LIMIT_S = 60.0


def test_pages_are_counted_by_their_tab() -> None:
    before: list[dict[str, float]] = [{"view": 10, "map": 0, "frames": 7}, {"view": 0, "map": 5, "frames": 0}]
    now: list[dict[str, float]] = [{"view": 40, "map": 0, "frames": 27}, {"view": 0, "map": 25, "frames": 0}]
    assert drawn(("view", "map"), before, now, 2.0) == [
        {"tab": "view", "view": 15.0, "frames": 10.0},
        {"tab": "map", "map": 10.0},
    ]


def test_memory_at_begin_and_end_is_a_median() -> None:
    samples = [{"own_mb": mb} for mb in (100.0, 101.0, 500.0, 0.0, 0.0, 0.0, 120.0, 121.0, 90.0)]
    assert own_mb({"memory": samples}) == (101.0, 120.0)
    assert own_mb({"memory": samples[:2]}) is None


def test_robot_without_station_has_all_other_modules() -> None:
    with_station, without = (profile(has_station, 1000, 50_000)["modules"] for has_station in (True, False))
    assert with_station.keys() - without.keys() == {"operator"}


def test_light_pages_receive_everything_and_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tools.load.operator.measure.PAIRS", 1)
    session = Session("pages", tabs=("view", "map", "cameras"), slow_bytes_per_s=1e6)
    result = measure(session, seconds=1.0, cells=100, points=500, settle_s=0.0)
    assert [page["tab"] for page in result["pages"]] == ["view", "map", "cameras"]
    assert result["station_percent"] > 0
    assert result["small"]["count"] > 0
    assert result["memory"][0]["connections"] >= 5
    assert len(row(result)) == len(HEADINGS)


def test_narrow_link_forwards_everything_and_nothing_at_rate_0() -> None:
    with (
        closing(socket.create_server(("127.0.0.1", 0))) as server,
        narrow_link(server.getsockname()[1]) as link,
        closing(socket.create_connection(("127.0.0.1", link.port))) as client,
    ):
        far, _ = server.accept()
        with far:
            for end in (client, far):
                end.settimeout(LIMIT_S)
            client.sendall(b"question")
            assert far.recv(100) == b"question"
            link.bytes_per_s = 0.0
            far.sendall(b"answer")
            client.settimeout(0.05)
            with pytest.raises(TimeoutError):
                client.recv(100)
            client.settimeout(LIMIT_S)
            link.bytes_per_s = 1e9
            assert client.recv(100) == b"answer"
