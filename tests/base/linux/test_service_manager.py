"""Notices to the service manager, received as systemd receives them."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.base.linux.service_manager import ServiceManager


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as bound:
        bound.bind(str(tmp_path / "notify"))
        bound.setblocking(False)
        yield bound


def received(receiver: socket.socket) -> list[str]:
    found = []
    try:
        while True:
            found.append(receiver.recv(4096).decode())
    except BlockingIOError:
        return found


def environment(receiver: socket.socket, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": receiver.getsockname(), **more}


def test_each_notice_is_told_when_it_is_new(receiver: socket.socket) -> None:
    service = ServiceManager.of_environment(environment(receiver))
    for is_ready, status, reason in (
        (False, "starts", ""),
        (True, "2 modules run", ""),
        (True, "2 modules run", ""),
        (True, "laser is DEGRADED:\nunplugged", ""),
        (True, "2 modules run", ""),
        (True, "stops", "got\nSIGTERM"),
        (True, "stops", "got\nSIGTERM"),
    ):
        service.turn(is_ready=is_ready, status=status, stop_reason=reason)
    service.close()
    assert received(receiver) == [
        "READY=1",
        "STATUS=2 modules run",
        "STATUS=laser is DEGRADED: unplugged",
        "STATUS=2 modules run",
        "STOPPING=1\nSTATUS=the run stops: got SIGTERM",
    ]


def test_watchdog_is_told_four_times_in_its_time(receiver: socket.socket) -> None:
    now_s = [0.0]
    service = ServiceManager(receiver.getsockname(), 2.0, lambda: now_s[0])
    for tenth in range(21):
        now_s[0] = tenth / 10
        service.turn(is_ready=False)
    service.close()
    assert received(receiver) == ["WATCHDOG=1"] * 5


@pytest.mark.parametrize(
    "more",
    [{}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getppid())}],
    ids=["none", "malformed", "of another process"],
)
def test_watchdog_that_is_not_ours_is_not_told(receiver: socket.socket, more: dict[str, str]) -> None:
    service = ServiceManager.of_environment(environment(receiver, **more))
    service.turn(is_ready=False)
    service.close()
    assert received(receiver) == []


def test_service_manager_that_takes_nothing_stops_nobody(receiver: socket.socket) -> None:
    now_s = [0.0]
    service = ServiceManager(receiver.getsockname(), 1.0, lambda: now_s[0])
    for second in range(1000):  # far more than fits into the socket
        now_s[0] = second
        service.turn(is_ready=False)
    assert received(receiver)
    service.turn(is_ready=True)
    service.close()
    assert received(receiver) == ["READY=1"]


def test_without_a_service_manager_nothing_is_opened() -> None:
    service = ServiceManager.of_environment({})
    service.turn(is_ready=True, stop_reason="over")
    service.close()
