"""The run that `robbie top` shows: the chosen one until its end, then the next one."""

from collections.abc import Iterator

import pytest

from robbie_mp.bus.observe import RunReading
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.cli.top_program import feed as feed_module
from robbie_mp.cli.top_program.feed import KEPT_VALUES, RunFeed, Watching
from robbie_mp.run.run_directory import KnownRun
from tests.cli._support.readings import laser, mapping, reading, run


class Machine:
    """The runs that are live."""

    def __init__(self) -> None:
        self.live: list[KnownRun] = []
        self.half_made: set[str] = set()
        self.open: list[str] = []
        self.now_s = 10.0


class Observer:
    def __init__(self, machine: Machine, run_id: str):
        if run_id in machine.half_made:
            raise SegmentMissing(run_id)
        self._machine, self._run_id = machine, run_id
        machine.open.append(run_id)

    def read(self) -> RunReading:
        self._machine.now_s += 1
        return reading(self._machine.now_s, laser(self._machine.now_s), mapping(self._machine.now_s))

    def close(self) -> None:
        self._machine.open.remove(self._run_id)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[Machine]:
    made = Machine()
    monkeypatch.setattr(feed_module, "live_runs", lambda: list(made.live))
    monkeypatch.setattr(feed_module, "RunObserver", lambda run_id: Observer(made, run_id))
    monkeypatch.setattr(feed_module, "is_live", lambda folder: folder in [one.folder for one in made.live])
    yield made
    assert not made.open, "a run is still mapped"


def test_single_run_is_watched_as_soon_as_it_exists(machine: Machine) -> None:
    feed = RunFeed()
    assert feed.poll().watching is Watching.NOTHING
    machine.live = [run()]
    machine.half_made = {"0a1b2c3d"}
    assert feed.poll().watching is Watching.NOTHING
    machine.half_made = set()
    first, second = feed.poll(), feed.poll()
    assert first.watching is Watching.RUN
    assert first.rates is None
    assert second.rates is not None
    assert second.rates.modules["laser"].out_hz == 40
    feed.close()


def test_run_that_has_ended_stays_in_view_until_the_next_one(machine: Machine) -> None:
    machine.live = [run()]
    feed = RunFeed()
    last = feed.poll()
    machine.live = []
    ended = feed.poll()
    assert ended.watching is Watching.ENDED
    assert ended.reading is last.reading
    machine.live = [run("99999999")]
    assert feed.poll().watching is Watching.RUN
    assert feed.history.values("routed") == [], "what was kept is of the other run"
    feed.close()


def test_user_chooses_among_several_runs(machine: Machine) -> None:
    machine.live = [run(), run("99999999")]
    feed = RunFeed()
    assert feed.poll().watching is Watching.SEVERAL
    feed.choose_next()
    assert feed.poll().run == machine.live[0]
    feed.choose_next()
    assert feed.poll().run == machine.live[1]
    feed.choose_next()
    assert feed.poll().run == machine.live[0]
    feed.close()


def test_requested_run_is_watched_even_if_there_are_others(machine: Machine) -> None:
    machine.live = [run(), run("99999999")]
    feed = RunFeed("99")
    assert feed.poll().run == machine.live[1]
    feed.close()


def test_history_is_bounded_and_has_the_newest_last(machine: Machine) -> None:
    machine.live = [run()]
    feed = RunFeed()
    for _ in range(KEPT_VALUES + 20):
        feed.poll()
    assert len(feed.history.values("module", "mapping", "in")) == KEPT_VALUES
    assert feed.history.values("channel", "sensor_msgs/msg/LaserScan", "1", "front")[-1] == 40
    feed.close()
