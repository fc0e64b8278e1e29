"""Commands that a link runs for others: how many, how long, and which."""

import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from robbie_mp.cli.remote_tool import NotForOthers, check
from robbie_mp.connect.link import tools
from robbie_mp.connect.link.header import ChannelId
from robbie_mp.connect.link.tools import MAX_RUNNING, LinkTools
from robbie_mp.messages import ToolReply, ToolRequest
from tests._support.robot import wait_until


@pytest.mark.parametrize(
    ("argv", "problem"),
    [
        (["run", "demo"], "only param, call, log, top"),
        ([], "only param, call, log, top"),
        (["top", "--csv", "/etc/x"], "/etc/x would be a file"),
        (["param", "load", "x.yaml"], "x.yaml would be a file"),
        (["log", "--run", "other"], "leave out --run"),
        (["log", "--robot", "other"], "leave out --run"),
    ],
)
def test_others_get_no_files_no_other_run_and_no_other_command(argv: list[str], problem: str) -> None:
    with pytest.raises(NotForOthers, match=problem):
        check(argv)


class Peer:
    """Somebody at the other end of a link."""

    def __init__(self) -> None:
        self.replies: list[ToolReply] = []
        self.is_there = True

    def is_up(self, robot: str) -> bool:
        return self.is_there

    def has_room(self, robot: str, name: ChannelId) -> bool:
        return self.is_there

    def reply(self, robot: str, reply: ToolReply, name: ChannelId) -> None:
        self.replies.append(reply)


@pytest.fixture
def peer() -> Peer:
    return Peer()


@pytest.fixture
def served(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> Iterator[LinkTools]:
    """Runs `sleep` in place of commands."""
    monkeypatch.setattr(LinkTools, "_command", lambda _self, _tool, request: request.arguments)
    link_tools = LinkTools("red", "", peer)
    yield link_tools
    link_tools.close()


def request(number: int, *arguments: str, **fields: Any) -> ToolRequest:
    return ToolRequest(request=number, robot="red", arguments=list(arguments), **fields)


def look_after_until(served: LinkTools, condition: Callable[[], bool]) -> None:
    def look() -> bool:
        served.look_after()
        return condition()

    wait_until(look)


def over(peer: Peer) -> dict[int, ToolReply]:
    return {reply.request: reply for reply in peer.replies if reply.is_over}


def test_no_more_commands_run_at_a_time_than_may(served: LinkTools, peer: Peer) -> None:
    for number in range(MAX_RUNNING + 1):
        served.take("laptop", "top", request(number, "sleep", "100"))
    assert (served.started, served.refused) == (MAX_RUNNING, 1)
    assert over(peer)[MAX_RUNNING].error == "red runs 4 commands for others already; try again\n"


def test_output_comes_whole_and_with_the_exit_code(served: LinkTools, peer: Peer) -> None:
    served.take(
        "laptop", "log", request(7, "sh", "-c", "cat; printf '\\0'; echo ö >&2; exit 3", input="ü" * 9000)
    )
    look_after_until(served, lambda: 7 in over(peer))
    assert "".join(reply.output for reply in peer.replies) == "ü" * 9000 + "\N{REPLACEMENT CHARACTER}"
    assert "".join(reply.error for reply in peer.replies) == "ö\n"
    assert over(peer)[7].exit_code == 3
    assert [reply.number for reply in peer.replies] == list(range(len(peer.replies)))


@pytest.mark.parametrize(
    ("tool", "asked", "problem"),
    [
        ("run", request(1, "x"), "red runs param, call, log, top for others; got 'run'"),
        ("log", request(1, "x" * 70_000), "more than 60000 bytes"),
        ("log", request(1, "no-such-program"), "cannot start it"),
    ],
)
def test_refused_command_is_answered(
    served: LinkTools, peer: Peer, tool: str, asked: ToolRequest, problem: str
) -> None:
    served.take("laptop", tool, asked)
    assert problem in over(peer)[1].error
    assert (served.started, served.refused) == (0, 1)


def test_interrupt_ends_the_command_of_its_sender_alone(served: LinkTools, peer: Peer) -> None:
    served.take("laptop", "log", request(1, "sleep", "100"))
    served.take("other", "log", request(1, interrupts=True))
    served.look_after()
    assert not over(peer)
    served.take("laptop", "log", request(1, interrupts=True))
    look_after_until(served, lambda: 1 in over(peer))
    assert over(peer)[1].exit_code == 128 + signal.SIGINT


def test_command_ends_when_its_client_has_gone(
    served: LinkTools, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "ALONE_S", 0.0)
    monkeypatch.setattr(tools, "GRACE_S", 0.05)
    served.take("laptop", "log", request(1, "sh", "-c", "trap '' INT; sleep 100"))
    peer.is_there = False
    look_after_until(served, lambda: not served._running)
    served.take("laptop", "log", request(2, "true"))
    assert served.started == 2


def test_request_with_a_nul_is_refused_and_the_link_goes_on(peer: Peer, served: LinkTools) -> None:
    request = ToolRequest.decode(ToolRequest(request=7, arguments=["aQb"]).encode().replace(b"aQb", b"a\0b"))
    served.take("hill", "top", request)
    assert served.refused == 1
    assert "cannot start it" in peer.replies[0].error


def test_command_that_ignores_an_interrupt_is_killed(
    served: LinkTools, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "GRACE_S", 0.1)
    text = "trap '' INT; echo ready; while :; do sleep 0.05; done"
    served.take("laptop", "log", ToolRequest(request=1, arguments=["sh", "-c", text]))

    def looked(condition: Callable[[], bool]) -> bool:
        served.look_after()
        return condition()

    wait_until(lambda: looked(lambda: any(reply.output for reply in peer.replies)))
    served.take("laptop", "log", ToolRequest(request=1, interrupts=True))
    wait_until(lambda: looked(lambda: peer.replies[-1].is_over), 10.0)
