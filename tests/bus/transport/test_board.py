from array import array

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.board import Board, SlotBounds, SlotState, Totals
from robbie_mp.bus.transport.words import WORD_MAX


def made() -> Board:
    board = Board(array("Q", bytes(8 * layout.board_words(2))))
    board.create(["supervisor", "camera"], [SlotBounds(), SlotBounds(1000, 2000, 3000)])
    return board


def test_row_is_read_as_it_was_written() -> None:
    board = made()
    past = Totals(1, 2, 3, 4, 5, 6)
    row = SlotState("camera", 2, 4711, 3, 2, 10**18, "ready", past, "killed by SIGSEGV", 5)
    board.write(1, row)
    assert board.read(1) == row
    assert board.read(0).name == "supervisor"
    assert board.bounds(1) == SlotBounds(1000, 2000, 3000)


def test_counters_that_a_dead_module_left_destroyed_still_fit() -> None:
    board = made()
    board.write(1, SlotState("camera", 2, 0, 3, 2, 0, "", Totals(published=3 * WORD_MAX)))
    assert board.read(1).past.published == WORD_MAX
