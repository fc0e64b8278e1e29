"""A procedure runs a coroutine from pause to pause, with the events that its owner tells it."""

import pytest

from robbie_mp.base.procedure import Procedure, pause


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
    procedure = Procedure(heard(2, told))
    procedure.tell("first")
    assert (told, procedure.is_over, procedure.result) == (["first"], False, None)
    procedure.tell()
    assert (told, procedure.is_over) == (["first", None, "end"], True)
    assert procedure.result == "has heard enough"
    procedure.tell("late")
    assert len(told) == 3


def test_cancelled_procedure_ends_where_it_waits() -> None:
    told: list[object] = []
    procedure = Procedure(heard(2, told))
    procedure.cancel()
    procedure.tell("late")
    assert (told, procedure.is_over, procedure.result) == (["end"], True, None)


def test_error_of_a_procedure_comes_to_its_owner() -> None:
    async def fails() -> None:
        await pause()
        raise ValueError("wrong")

    procedure = Procedure(fails())
    with pytest.raises(ValueError, match="wrong"):
        procedure.tell()
