"""A procedure runs a coroutine from pause to pause; with a journal, its next process goes on with it."""

import pytest

from robbie_mp.base.procedure import Journal, Procedure, WrongJournal, pause


async def heard(count: int, into: list[object]) -> str:
    """Hear a number of events."""
    try:
        for _ in range(count):
            into.append(await pause())
        return "has heard enough"
    finally:
        into.append("end")


def test_procedure_goes_on_from_pause_to_pause_with_each_event() -> None:
    told: list[object] = []
    procedure = Procedure[str]()
    assert procedure.is_over
    procedure.begin(heard(2, told))
    procedure.tell("first")
    assert (told, procedure.is_over, procedure.result) == (["first"], False, None)
    procedure.tell()
    assert (told, procedure.is_over) == (["first", None, "end"], True)
    assert procedure.result == "has heard enough"
    procedure.tell("late")
    assert len(told) == 3


def test_cancelled_procedure_ends_where_it_waits() -> None:
    told: list[object] = []
    procedure = Procedure[str]()
    assert procedure.is_over
    procedure.begin(heard(2, told))
    assert procedure.cancel()
    assert not procedure.cancel()
    procedure.tell("late")
    assert (told, procedure.is_over, procedure.result) == (["end"], True, None)


def test_new_procedure_ends_the_one_before() -> None:
    told: list[object] = []
    procedure = Procedure[str]()
    procedure.begin(heard(2, told))
    procedure.begin(heard(1, told))
    assert told == ["end"]
    procedure.tell("first")
    assert (told, procedure.result) == (["end", "first", "end"], "has heard enough")


def test_error_of_a_procedure_comes_to_its_owner() -> None:
    async def fails() -> None:
        await pause()
        raise ValueError("wrong")

    procedure = Procedure[None]()
    procedure.begin(fails())
    with pytest.raises(ValueError, match="wrong"):
        procedure.tell()
    assert procedure.is_over


class Trip:
    """Two ways, each of two parts; it notes what it does."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.done: list[str] = []
        self.run = Procedure[list[str]]()
        self.run.begin(self.both())

    async def both(self) -> list[str]:
        first = self.journal.once(self.choose)
        return [await self.journal.step(self.way(name)) for name in (first, "back")]

    def choose(self) -> str:
        self.done.append("choose")
        return "there"

    async def way(self, name: str) -> str:
        parts = [await self.journal.step(self.part(f"{name} {number}")) for number in (1, 2)]
        return " and ".join(parts)

    async def part(self, name: str) -> str:
        self.done.append(name)
        return f"{name}: {await pause()}"


@pytest.mark.parametrize("killed_after", range(4))
def test_next_process_skips_what_is_done_and_begins_again_with_the_step_that_was_not(
    killed_after: int,
) -> None:
    trip, done = Trip(Journal()), []
    for event in range(4):
        if event == killed_after:
            done = trip.done[:-1]  # it begins again with its last step
            trip = Trip(Journal(trip.journal.memory))
        assert not trip.journal.is_replaying
        trip.run.tell(str(event))
    assert trip.run.result == ["there 1: 0 and there 2: 1", "back 1: 2 and back 2: 3"]
    assert done + trip.done == ["choose", "there 1", "there 2", "back 1", "back 2"]
    assert [name for name, _ in trip.journal.memory[0]] == ["choose", "way", "way"]  # one for each


def test_journal_of_another_procedure_is_an_error() -> None:
    with pytest.raises(WrongJournal, match="choose is next, but the journal has way"):
        Trip(Journal([[("way", "there")]]))


def test_journal_is_cleared_for_what_is_next() -> None:
    trip = Trip(Journal())
    for _ in range(4):
        trip.run.tell()
    trip.journal.clear()
    assert trip.journal.memory == [[]] and not trip.journal.is_replaying
