"""The counts of many sessions: rows are given back, and no count is lost, wherever the process is killed."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp.connect.link import counts as link_counts
from robbie_mp.connect.link.counts import (
    KEPT_SESSIONS,
    NEXT,
    RECEIVED,
    REFUSED,
    TAKEN,
    CountKey,
    ExchangeCounts,
    LinkCounts,
)
from robbie_mp.connect.link.traffic import TrafficClass

ROWS = 200
ODOM = ("nav_msgs/msg/Odometry", 1, "odom")
MAP = ("nav_msgs/msg/OccupancyGrid", 1, "map")


@pytest.fixture(autouse=True)
def few_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_counts, "MAX_ROWS", ROWS)


def receive(counts: LinkCounts, session: int) -> None:
    """Count what comes in a session of blue: a message of each channel, and one that is refused."""
    counts.row(CountKey("stream", "blue", session, TrafficClass.STATE))[NEXT] = session
    for number, channel in enumerate((ODOM, MAP)):
        row = counts.row(CountKey("in", "blue", session, TrafficClass.STATE, number, *channel))
        row.add(RECEIVED)
        row.add(REFUSED)


def send(counts: LinkCounts) -> None:
    """Count what goes to blue: three messages, of which one arrives."""
    row = counts.row(CountKey("out", "blue", counts.session, TrafficClass.STATE, 0, *ODOM))
    row.add(TAKEN, 3)
    row.add(RECEIVED)


def figures(counts: LinkCounts) -> dict[tuple[bool, str], ExchangeCounts]:
    return {(one.is_sent, one.channel.topic): one for one in counts.channels()}


def test_rows_of_sessions_that_ended_long_ago_are_given_back_and_their_sums_stay() -> None:
    counts = LinkCounts(None, "link", 7)
    send(counts)
    row = counts.row(CountKey("out", "blue", 7, TrafficClass.STATE, 0, *ODOM))
    for session in range(1000, 2000):
        receive(counts, session)
    assert counts.unlisted == 0
    row.add(TAKEN)  # a channel that was opened before still counts in its row
    found = figures(counts)
    assert (found[False, "odom"].received, found[False, "map"].dropped) == (1000, 1000)
    assert (found[True, "odom"].sent, found[True, "odom"].under_way) == (4, 3)
    assert counts.sessions_of("blue")[-KEPT_SESSIONS:] == list(range(2000 - KEPT_SESSIONS, 2000))
    assert counts.streams_of("blue", 1999)[TrafficClass.STATE][NEXT] == 1999
    assert counts.received_from("blue", 1999, TrafficClass.STATE) == [(0, 1, 1), (1, 1, 1)]


def test_sums_of_own_earlier_sessions_stay_and_what_was_under_way_is_lost(tmp_path: Path) -> None:
    for session in range(1, 500):
        counts = LinkCounts(tmp_path, "link", session)
        send(counts)
        counts.close()
    counts = LinkCounts(tmp_path, "link", 500)
    found = figures(counts)[True, "odom"]
    assert counts.unlisted == 0
    assert (found.sent, found.received, found.lost) == (3 * 499, 499, 2 * 499)
    assert len(list(tmp_path.iterdir())) == 2
    counts.close()


@pytest.mark.parametrize("step", ["_map", "json.dumps", "os.replace", "Path.unlink"])
def test_no_count_is_lost_if_the_process_is_killed_while_rows_are_given_back(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = LinkCounts(tmp_path, "link", 7)
    send(counts)
    sessions = iter(range(1000, 2000))
    while len(list(counts)) < ROWS - 2:
        receive(counts, next(sessions))
    before = figures(counts)
    with monkeypatch.context() as patch:
        kill_at(step, patch)
        with pytest.raises(Killed):
            for session in sessions:
                counts.row(CountKey("stream", "blue", session, TrafficClass.STATE))
    again = LinkCounts(tmp_path, "link", 8)
    after = figures(again)
    assert {key: one.received for key, one in after.items()} == {
        key: one.received for key, one in before.items()
    }
    assert after[True, "odom"].sent == 3
    assert len(list(tmp_path.iterdir())) == 2
    receive(again, 3000)
    again.close()


class Killed(Exception):
    """Stands for the end of the process."""


def kill_at(step: str, patch: pytest.MonkeyPatch) -> None:
    """Have a step of the replacement raise."""

    def killed(*_: object, **__: object) -> None:
        raise Killed

    def later(after: int, call: Callable[..., object]) -> Callable[..., object]:
        count = 0

        def counted(*given: object, **named: object) -> object:
            nonlocal count
            count += 1
            if count > after:
                raise Killed
            return call(*given, **named)

        return counted

    if step == "_map":
        patch.setattr(link_counts, "_map", killed)
    elif step == "json.dumps":  # that of the first keys are those of rows that are opened before
        patch.setattr(json, "dumps", later(10, json.dumps))
    elif step == "os.replace":
        patch.setattr(os, "replace", killed)
    else:  # the first one makes way for the new counts
        patch.setattr(Path, "unlink", later(1, Path.unlink))
