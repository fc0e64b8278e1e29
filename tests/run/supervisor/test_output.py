"""The output of children: complete up to a limit, bounded and counted beyond it."""

import itertools
import os
import time
from collections.abc import Iterator
from pathlib import Path
from unicodedata import category

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robbie_mp.run.profile.model import TraceSettings
from robbie_mp.run.supervisor.event_loop import EventLoop
from robbie_mp.run.supervisor.output import ChildOutput, LogNotWritable, OutputStore
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.supervisor.streams import OutputStream
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.rotating_file import RotatingFile
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, Run, Scenario, animal


class Recorder:
    """One child's output, fed by hand."""

    def __init__(self, folder: Path, limits: TraceSettings):
        self.lines: list[Entry] = []
        self.store = OutputStore(folder, self.lines.append, limits)
        self.output: ChildOutput = self.store.child("child")
        self.loop = EventLoop(time.monotonic)

    def feed(self, *chunks: bytes) -> None:
        reader, writer = os.pipe()
        os.set_blocking(reader, False)
        stream = OutputStream(reader, "stdout", self.output, self.loop)
        for chunk in chunks:
            os.write(writer, chunk)
            self.loop.turn(0.0)
        os.close(writer)
        stream.finish()

    def close(self) -> None:
        self.output.close()
        self.store.close()
        self.loop.close()


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    made = Recorder(tmp_path, TraceSettings(line_characters=20, lines_per_s=1e9))
    yield made
    made.close()


def texts(lines: list[Entry]) -> list[str]:
    return [line.text for line in lines]


@given(st.binary(max_size=200), st.lists(st.integers(0, 200), max_size=5))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_lines_do_not_depend_on_how_the_bytes_are_split(
    recorder: Recorder, data: bytes, cuts: list[int]
) -> None:
    cuts = sorted({0, len(data), *(min(cut, len(data)) for cut in cuts)})
    pieces = [data[begin:end] for begin, end in itertools.pairwise(cuts)]
    recorder.lines.clear()
    recorder.feed(data)
    whole = texts(recorder.lines)
    recorder.lines.clear()
    recorder.feed(*pieces)
    assert texts(recorder.lines) == whole
    assert not [
        character for character in "".join(whole) if category(character) == "Cc" and character != "\t"
    ]
    assert sum(map(len, whole)) >= len(data.decode("utf-8", "replace").replace("\n", "").replace("\r", ""))


def test_character_that_arrives_in_halves_is_whole(recorder: Recorder) -> None:
    recorder.feed("grün".encode()[:3], "grün".encode()[3:] + b"\r\n\r\n")
    assert texts(recorder.lines) == ["grün", ""]


def test_long_line_is_cut_into_several(recorder: Recorder) -> None:
    recorder.feed(b"x" * 45 + b"\nshort\n")
    assert texts(recorder.lines) == ["x" * 20, "x" * 20, "x" * 5, "short"]


def test_escape_sequences_do_not_reach_the_terminal(recorder: Recorder) -> None:
    recorder.feed(b"\x1b[2J\x00\xff\n")
    assert texts(recorder.lines) == ["\\x1b[2J\\x00\N{REPLACEMENT CHARACTER}"]


def test_last_lines_are_of_the_current_incarnation_only(recorder: Recorder) -> None:
    recorder.output.begin(1)
    recorder.feed(b"old\n")
    recorder.output.begin(2)
    recorder.feed(b"new\n")
    assert recorder.output.last_lines == ("new",)
    assert [line.incarnation for line in recorder.lines] == [1, 2]


def test_flood_is_dropped_and_counted_and_its_end_is_kept(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, TraceSettings(lines_per_s=0.0, burst_lines=10, kept_lines=3))
    recorder.feed(b"".join(b"line %d\n" % number for number in range(100)))
    recorder.close()
    assert texts(recorder.lines) == [
        *(f"line {number}" for number in range(10)),
        "90 lines dropped: too many at once (more than 0 lines/s)",
    ]
    assert (recorder.output.dropped, recorder.output.lines) == (90, 11)
    assert recorder.output.last_lines == ("line 97", "line 98", "line 99")


def test_log_line_has_time_incarnation_and_stream(tmp_path: Path, recorder: Recorder) -> None:
    recorder.output.begin(7)
    recorder.feed(b"hello\n")
    recorder.store.flush()
    entry = Entry.from_line((tmp_path / "child.jsonl").read_bytes())
    assert entry == recorder.lines[0]
    assert (entry.incarnation, entry.stream, entry.text, entry.kind) == (7, "stdout", "hello", Kind.INFO)
    assert abs(entry.time_s - time.time()) < 60


def test_log_never_takes_more_disk_than_its_bound(tmp_path: Path) -> None:
    file = RotatingFile(tmp_path / "a.log", max_bytes=100, files=3)
    for number in range(100):
        file.write(b"%029d\n" % number)
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 300
    file.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.1.log", "a.2.log", "a.log"]
    kept = b"".join((tmp_path / name).read_bytes() for name in ("a.2.log", "a.1.log", "a.log"))
    assert kept == b"".join(b"%029d\n" % number for number in range(93, 100))


def test_log_of_one_file_starts_again_when_full(tmp_path: Path) -> None:
    file = RotatingFile(tmp_path / "a.log", max_bytes=10, files=1)
    for _ in range(5):
        file.write(b"12345678")
    file.close()
    assert (tmp_path / "a.log").read_bytes() == b"12345678"


def test_log_is_continued_by_the_next_run(tmp_path: Path) -> None:
    for text in (b"one\n", b"two\n"):
        file = RotatingFile(tmp_path / "a.log", max_bytes=100, files=2)
        file.write(text)
        file.close()
    assert (tmp_path / "a.log").read_bytes() == b"one\ntwo\n"


def test_refused_writes_are_counted_and_block_nothing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, TraceSettings())
    (tmp_path / "child.jsonl").mkdir()  # so that nothing can be written there
    recorder.output.add("stdout", ["one", "two"])
    recorder.store.flush()
    (tmp_path / "child.jsonl").rmdir()
    recorder.output.add("stdout", ["three"])
    recorder.close()
    assert texts(recorder.lines) == ["one", "two", "three"]
    assert recorder.output.dropped == 2
    assert b"three" in (tmp_path / "child.jsonl").read_bytes()


def test_folder_that_cannot_be_created_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(LogNotWritable, match="choose another"):
        OutputStore(tmp_path / "file" / "logs")


def test_folder_that_cannot_be_written_to_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)
    with pytest.raises(LogNotWritable, match="no permission"):
        OutputStore(tmp_path)


def test_flooding_child_is_not_blocked_for_ever_and_the_others_are_served(tmp_path: Path) -> None:
    run = Run(
        tmp_path,
        animal(zoo.floods),
        animal(zoo.works_busily),
        limits=TraceSettings(lines_per_s=500.0, burst_lines=50),
    )
    begin_s = time.monotonic()

    def scenario() -> Scenario:
        yield run.all_running
        yield lambda: run.tree.child("floods").output.dropped > 20000
        yield lambda: len(run.text("works_busily", "stdout")) > 20
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert len(run.text("floods", "stdout")) <= 50 + 500.0 * (time.monotonic() - begin_s)
    assert any("lines dropped" in text for text in run.text("floods", "supervisor"))
    assert run.tree.child("works_busily").output.dropped < run.tree.child("floods").output.dropped / 10


def test_traceback_after_a_flood_is_kept(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.floods_and_fails, restart=NEVER), limits=TraceSettings(burst_lines=10))
    assert run.play() == 1
    assert run.last("floods_and_fails").last_lines[-1] == "RuntimeError: drowned"
    assert run.text("floods_and_fails", "stderr")[-1] == "RuntimeError: drowned"


def test_binary_garbage_and_half_a_line_at_the_end_are_kept(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.writes_garbage))
    assert run.play() == 0
    assert run.text("writes_garbage", "stderr") == ["\\x1b]0;title\\x07half a line"]
    assert len(run.text("writes_garbage", "stdout")) >= 40


def test_child_that_closes_its_output_continues(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.closes_output))

    def scenario() -> Scenario:
        yield run.all_running
        turns = run.turns
        yield lambda: run.turns > turns + 3
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.states("closes_output") == [ChildState.STARTING, ChildState.RUNNING, ChildState.STOPPED]


def test_disk_that_refuses_is_told_once_with_its_reason(recorder: Recorder) -> None:
    (recorder.store.folder / "child.jsonl").mkdir()
    for _ in range(3):
        recorder.output.say(Kind.INFO, "lost")
    assert recorder.store.flush()
    assert recorder.store.turn() == (
        f"{recorder.store.folder} does not take what the run writes (Is a directory): 3 pieces of it are lost"
    )
    assert recorder.store.turn() == ""
    assert recorder.store.disk.refused == recorder.output.dropped == 3


def test_page_whose_head_the_disk_refused_begins_with_it_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = RotatingFile(tmp_path / "page", max_bytes=1000, files=1, head=b"<!doctype html>")
    with monkeypatch.context() as full:
        full.setattr(os, "write", lambda fd, data, write=os.write: write(fd, data[:4]))
        with pytest.raises(OSError, match="No space left"):
            file.write(b"one")
    file.write(b"two")
    file.close()
    assert (tmp_path / "page").read_bytes() == b"<!doctype html>two"
