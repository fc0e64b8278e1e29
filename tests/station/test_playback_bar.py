"""PressedKeys steer a playback by what they have ordered, also when they are quicker than its answers."""

from types import SimpleNamespace
from typing import cast
from unittest.mock import Mock

import pytest

from robbie_mp.messages import PlaybackControl, PlaybackState, Time
from robbie_mp.station.watch.latest import MessageSource

pytest.importorskip("nicegui", reason="the operator's page needs the extra gui")

from robbie_mp.station.page import playback_bar
from robbie_mp.station.page.playback_bar import ANSWERED_WITHIN_S, PlaybackBar


class PressedKeys:
    """The keys of a page beside a log of a minute; the playback answers when it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.now_s = 100.0
        monkeypatch.setattr(playback_bar, "time", SimpleNamespace(monotonic=lambda: self.now_s))
        state = PlaybackState(end=Time(sec=60), position=Time(sec=20), rate=2.0)
        self.latest = SimpleNamespace(message=state, count=1)
        source = SimpleNamespace(newest=lambda _type: self.latest)
        self.bar = PlaybackBar(cast(MessageSource, source))
        self.page = Mock(plays_log=True)
        self.bar.add_keys(self.page)
        self._actions = {call.args[0]: call.args[2] for call in self.page.add_key.call_args_list}

    def press(self, *keys: str) -> list[tuple[str, float]]:
        """Press keys one after another, and return what they have ordered."""
        self.page.publish.reset_mock()
        for key in keys:
            self._actions[key]()
        return [(one.command, one.value) for one in self.ordered()]

    def ordered(self) -> list[PlaybackControl]:
        return [call.args[0] for call in self.page.publish.call_args_list]


def test_second_press_begins_where_the_first_one_leads(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = PressedKeys(monkeypatch)
    assert keys.press("-", "-", "+") == [("rate", 1.0), ("rate", 0.5), ("rate", 1.0)]
    assert keys.press("arrowright", "arrowright", "arrowleft") == [("seek", 25), ("seek", 30), ("seek", 25)]
    assert keys.press("k", "k", "k") == [("pause", 0), ("resume", 0), ("pause", 0)]
    assert keys.press("-", ".", "-") == [("rate", 0.5), ("step", 0), ("rate", 0.25)]


def test_answer_counts_more_than_what_was_ordered(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = PressedKeys(monkeypatch)
    keys.press("-")
    (order,) = keys.ordered()
    keys.latest.message = PlaybackState(end=Time(sec=60), rate=4.0, request=order.request, error="no")
    assert keys.press("-") == [("rate", 2.0)]


def test_order_that_is_lost_or_refused_leads_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = PressedKeys(monkeypatch)
    keys.press("-")
    keys.now_s += ANSWERED_WITHIN_S
    assert keys.press("-") == [("rate", 1.0)]
    keys.now_s += ANSWERED_WITHIN_S
    keys.page.publish.return_value = False
    assert keys.press("-", "-") == [("rate", 1.0), ("rate", 1.0)]
