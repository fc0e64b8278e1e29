"""Every reader refuses damaged inputs with an error of its own; the tool notices readers that do not."""

import os
import time
from pathlib import Path
from random import Random

import pytest

from tools.fuzz.readers import campaign
from tools.fuzz.readers.campaign import Files, ReaderUnderTest, damaged_input, run
from tools.fuzz.readers.mutation import mutated
from tools.fuzz.readers.subjects import subjects

DAMAGED_BYTES = 10_000


@pytest.mark.slow
@pytest.mark.parametrize("name", subjects())
def test_reader_reads_or_refuses_damaged_inputs(name: str) -> None:
    result = run(name, "tools.fuzz.readers.subjects:subjects", DAMAGED_BYTES, seed=1)
    assert result.failures == {}
    assert result.damaged_bytes >= DAMAGED_BYTES
    assert result.inputs == result.accepted + result.refused > 0


def seeds() -> list[Files]:
    return [{"data": b"0123456789" * 10}]


def raises(folder: Path) -> None:
    if (folder / "data").read_bytes() != seeds()[0]["data"]:
        raise KeyError("no such key")


def hangs(folder: Path) -> None:
    if (folder / "data").read_bytes() != seeds()[0]["data"]:
        time.sleep(60.0)


def dies(folder: Path) -> None:
    if (folder / "data").read_bytes() != seeds()[0]["data"]:
        os.abort()


def takes_memory(folder: Path) -> None:
    if (folder / "data").read_bytes() != seeds()[0]["data"]:
        bytearray(2 * campaign.MEMORY_BYTES)


def refuses_all(_folder: Path) -> None:
    raise ValueError("no")


def bad_readers() -> dict[str, ReaderUnderTest]:
    return {
        "raises": ReaderUnderTest(seeds, raises),
        "hangs": ReaderUnderTest(seeds, hangs),
        "dies": ReaderUnderTest(seeds, dies),
        "takes_memory": ReaderUnderTest(seeds, takes_memory),
        "refuses_all": ReaderUnderTest(seeds, refuses_all),
    }


BAD_READERS = f"{__name__}:bad_readers"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "failure"),
    [
        ("raises", "KeyError in test_fuzz_readers.py"),
        ("hangs", "hangs: no answer"),
        ("dies", "the process died"),
        ("takes_memory", "MemoryError in test_fuzz_readers.py"),
    ],
)
def test_reader_that_fails_is_reported_with_the_input(
    name: str, failure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign, "MAX_LOST", 1)
    monkeypatch.setattr(campaign, "START_S", 30.0 if name != "hangs" else 3.0)
    result = run(name, BAD_READERS, 1, seed=2)
    (told,) = result.failures
    assert told.startswith(failure) and result.failures[told] == [0]


@pytest.mark.slow
def test_reader_that_refuses_valid_inputs_ends_the_campaign() -> None:
    with pytest.raises(RuntimeError, match="a valid input is refused"):
        run("refuses_all", BAD_READERS, 1)


def test_inputs_are_the_same_for_the_same_seed_and_differ_otherwise() -> None:
    reader = ReaderUnderTest(seeds, raises)
    made = [damaged_input(reader, seeds(), 1, number)[0]["data"] for number in range(20)]
    assert made == [damaged_input(reader, seeds(), 1, number)[0]["data"] for number in range(20)]
    assert len(set(made)) > 15


def test_empty_inputs_are_damaged_too() -> None:
    for number in range(200):
        mutated(b"", Random(number), (b"word",))
