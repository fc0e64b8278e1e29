"""A /dev/shm without room, a process without descriptors: an error says so, and nothing is left behind.

There it is a small file system of the test's own, in a namespace of mounts of a process of its own.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.run_memory import IncarnationMemory, RingSizes
from robbie_mp.bus.transport.segment import SharedMemoryFull
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from tests._support.few_descriptors import only_free_descriptors
from tests._support.places import PROJECT
from tests.bus.transport._support.pair import Pair, picture

RUN_ID = f"test{os.getpid()}"
SIZES = RingSizes(16, 4)
IN_OWN_MEMORY = ["unshare", "--mount", "--propagation", "private"]

CREATE = """
import os, subprocess, sys
from robbie_mp.bus.transport.layout import in_words, out_words
from robbie_mp.bus.transport.run_memory import IncarnationMemory, RingSizes
from robbie_mp.bus.transport.segment import SharedMemoryFull
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names

sizes = RingSizes(16, 4)
out, into = (-(-8 * words // 4096) for words in (out_words(16), in_words(4)))
pages = [1, out - 1, out, out + into - 1, out + into, out + into + 1, out + into + 3]
outcomes = []
for option in [*[f"nr_inodes={number}" for number in range(2, 8)],
               *[f"size={4096 * number}" for number in pages]]:
    subprocess.run(["mount", "-t", "tmpfs", "-o", option, "none", SHARED_MEMORY], check=True)
    opened = len(os.listdir("/proc/self/fd"))
    make_folder("7e57f011")
    try:
        memory = IncarnationMemory.create("7e57f011", 1, 1, sizes)
    except SharedMemoryFull as error:
        assert "no room in /dev/shm for " in str(error), error
        outcomes.append(str(error).split(" for ")[1].split(" of ")[0].split(".")[0])
    else:
        memory.close()
        memory.unlink()
        outcomes.append("made")
    assert remove_names("7e57f011") == ["robbie-7e57f011"], (option, "the empty folder")
    assert os.listdir(SHARED_MEMORY) == [], (option, os.listdir(SHARED_MEMORY))
    assert len(os.listdir("/proc/self/fd")) == opened, option
    subprocess.run(["umount", SHARED_MEMORY], check=True)
print(*dict.fromkeys(outcomes), sep="\\n")
"""


def has_own_mounts() -> bool:
    """Whether this user may mount a /dev/shm that nobody else sees."""
    mount = ["mount", "-t", "tmpfs", "none", str(SHARED_MEMORY)]
    try:
        return subprocess.run([*IN_OWN_MEMORY, *mount], check=False, capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


def run(code: str) -> str:
    if not has_own_mounts():
        pytest.skip("NOT TESTED: only root may mount a small /dev/shm for this test")
    ended = subprocess.run(
        [*IN_OWN_MEMORY, sys.executable, "-c", code],
        check=False, capture_output=True, text=True, timeout=50,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(PROJECT), *sys.path])},
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_incarnation_for_which_any_piece_finds_no_room_leaves_no_name() -> None:
    assert set(run(CREATE).splitlines()) == {
        "segment robbie-7e57f011/wakeup-1-1",
        "segment robbie-7e57f011/out-1-1",
        "segment robbie-7e57f011/in-1-1",
        "made",
    }


@pytest.fixture
def folder() -> Iterator[None]:
    make_folder(RUN_ID)
    yield
    assert remove_names(RUN_ID) == [f"robbie-{RUN_ID}"], "only the empty folder is left"


def descriptors() -> list[str]:
    return sorted(os.listdir("/proc/self/fd"))


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("free", range(5))
def test_incarnation_for_which_descriptors_run_out_leaves_nothing(free: int) -> None:
    before = descriptors()
    with only_free_descriptors(free):
        try:
            memory = IncarnationMemory.create(RUN_ID, 1, 1, SIZES)
        except SharedMemoryFull as error:
            assert "ulimit -n" in str(error)
            memory = None
    if memory is not None:
        assert free == 4, (
            "an incarnation takes a descriptor for each of its two segments, and two more to make them"
        )
        memory.close()
        memory.unlink()
    assert descriptors() == before


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("attach", [IncarnationMemory.attach_as_module, IncarnationMemory.attach_as_core])
def test_attaching_for_which_descriptors_run_out_keeps_none(
    attach: Callable[[str, int, int], IncarnationMemory],
) -> None:
    memory = IncarnationMemory.create(RUN_ID, 1, 1, SIZES)
    before = descriptors()
    try:
        for free in range(3):
            with only_free_descriptors(free), pytest.raises(OSError, match=r"open files|files open"):
                attach(RUN_ID, 1, 1)
            assert descriptors() == before
        with only_free_descriptors(4):
            attach(RUN_ID, 1, 1).close()
    finally:
        memory.close()
        memory.unlink()


def test_message_whose_segment_cannot_be_made_for_want_of_descriptors_is_refused_and_counted(
    pair: Pair,
) -> None:
    with only_free_descriptors(0):
        assert not pair.outbox.publish(picture(1), "")
    assert pair.sender_words[layout.OUT_REFUSED] == 1
    assert pair.outbox.publish(picture(2), "")
    seen: list[int] = []
    pair.on_image = lambda image: seen.append(int(image.data[0]))
    pair.pass_on()
    assert seen == [2]
