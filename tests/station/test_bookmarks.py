"""Bookmarks of a log are kept beside it, and a damaged file of them is reported and does no harm."""

from pathlib import Path

from robbie_mp.station.past.bookmarks import MAX_BOOKMARKS, Bookmark, Bookmarks, file_of


def opened(log: Path) -> Bookmarks:
    bookmarks = Bookmarks()
    bookmarks.open(str(log))
    return bookmarks


def test_bookmarks_are_there_when_the_log_is_opened_again(tmp_path: Path) -> None:
    log = tmp_path / "way.mcap"
    bookmarks = opened(log)
    later, first = bookmarks.add(9), bookmarks.add(5)
    assert first is not None
    assert later is not None
    assert [one.text for one in bookmarks.all] == ["bookmark 2", "bookmark 1"]  # by time
    bookmarks.rename(first, " the corner ")
    bookmarks.remove(later)
    assert opened(log).all == (Bookmark(5, "the corner"),)
    assert opened(tmp_path / "other.mcap").all == ()


def test_folder_with_parts_has_them_inside(tmp_path: Path) -> None:
    opened(tmp_path).add(1)
    assert file_of(tmp_path).parent == tmp_path
    assert len(opened(tmp_path).all) == 1


def test_damaged_file_and_one_that_cannot_be_written_are_reported(tmp_path: Path) -> None:
    log = tmp_path / "way.mcap"
    file_of(log).write_text('[{"time": 3}]')
    bookmarks = opened(log)
    assert bookmarks.all == ()
    assert "cannot be read" in bookmarks.error
    assert bookmarks.add(7) is not None
    assert "cannot be read" in bookmarks.error
    assert file_of(log).read_text() == '[{"time": 3}]', "what somebody may still save is overwritten"
    bookmarks.open(str(tmp_path / "other.mcap"))
    bookmarks.add(7)
    assert len(opened(tmp_path / "other.mcap").all) == 1
    gone = opened(tmp_path / "gone" / "way.mcap")
    assert gone.add(1) is not None
    assert "they end with" in gone.error


def test_number_of_bookmarks_is_bounded(tmp_path: Path) -> None:
    bookmarks = opened(tmp_path / "way.mcap")
    assert all(bookmarks.add(at) for at in range(MAX_BOOKMARKS))
    assert bookmarks.add(1) is None


def test_name_of_a_log_that_no_file_can_have_is_no_error_of_the_page() -> None:
    bookmarks = Bookmarks()
    bookmarks.open("x" * 5000)
    assert "cannot be read" in bookmarks.error
    assert bookmarks.add(5) is not None
