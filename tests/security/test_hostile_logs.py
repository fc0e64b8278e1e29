"""Small files that would take all memory or endless time are refused quickly, with the place and limit."""

import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zstandard

from robbie_mp.logs.recording.errors import LogLimitExceeded
from robbie_mp.logs.recording.limits import READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import message_type_from_schema
from robbie_mp.messages.errors import SchemaError
from tests._support.robot import COMMAND
from tests.security._support.hostile_logs import (
    GIGABYTE,
    MEGABYTE,
    PACKERS,
    ZEROS_HEAD_BYTES,
    bomb,
    channel_record,
    chunk_record,
    log_of,
    message_record,
    schema_record,
    zstd_with_size,
)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
LIMIT_S = 120.0
ADDRESS_SPACE_BYTES = 4 * GIGABYTE
"""Limit of memory, so that a successful attack does not affect the machine."""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    errors: str
    peak_bytes: int
    """What it had in memory at most."""


MEASURE = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[2:])
_, status, usage = os.wait4(process.pid, 0)
process.returncode = os.waitstatus_to_exitcode(status)
with open(sys.argv[1], "w") as peak:
    peak.write(str(usage.ru_maxrss))
sys.exit(process.returncode)
"""
"""Starts a command and writes down its peak, which begins with that of its parent: this one is small."""


def run(*words: str, folder: Path) -> Ended:
    """Run a command in another process and watch what it takes."""
    peak = folder / "peak"
    with open(folder / "errors", "w+") as errors:
        process = subprocess.Popen(
            [
                sys.executable,
                "-ISc",
                MEASURE,
                peak,
                "prlimit",
                f"--as={ADDRESS_SPACE_BYTES}",
                *COMMAND,
                *words,
            ],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        try:
            code = process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise AssertionError(f"{words} still worked after {LIMIT_S} s") from None
        errors.seek(0)
        return Ended(code, errors.read(), int(peak.read_text()) * 1024)


@pytest.fixture(scope="module")
def idle_bytes(tmp_path_factory: pytest.TempPathFactory) -> int:
    """What the program takes to look at a log with nothing in it."""
    folder = tmp_path_factory.mktemp("idle")
    return run("info", str(log_of(folder / "none.mcap")), folder=folder).peak_bytes


@pytest.mark.parametrize("packer", PACKERS)
def test_chunk_that_decompresses_to_a_gigabyte_is_refused(
    packer: str, tmp_path: Path, idle_bytes: int
) -> None:
    log = bomb(tmp_path / "bomb.mcap", packer)
    assert log.stat().st_size < GIGABYTE / 200
    place = log_of(tmp_path / "none.mcap").stat().st_size
    ended = run("info", str(log), folder=tmp_path)
    assert ended.code == 2
    assert "Traceback" not in ended.errors
    assert f"{log}: byte {place}: " in ended.errors
    assert f"of {GIGABYTE + ZEROS_HEAD_BYTES} bytes" in ended.errors
    assert f"the limit is {READ_LIMITS.chunk_bytes} bytes" in ended.errors and "--max-chunk" in ended.errors
    assert ended.peak_bytes - idle_bytes < 1.2 * READ_LIMITS.chunk_bytes


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "words",
    [["recording repair"], ["export", "OUT"], ["diff", "SAME"], ["play"]],
    ids=lambda words: words[0],
)
def test_every_command_refuses_such_a_chunk(words: list[str], tmp_path: Path, idle_bytes: int) -> None:
    log = str(bomb(tmp_path / "bomb.mcap", "zstd"))
    others = {"OUT": str(tmp_path / "out"), "SAME": log}
    ended = run(*words[0].split(), log, *(others[word] for word in words[1:]), folder=tmp_path)
    assert ended.code == 2 and "Traceback" not in ended.errors
    assert log in ended.errors and "byte " in ended.errors and "the limit is" in ended.errors
    assert ended.peak_bytes - idle_bytes < 1.2 * READ_LIMITS.chunk_bytes


def test_larger_chunk_can_be_allowed(tmp_path: Path) -> None:
    log = bomb(tmp_path / "large.mcap", "zstd", 2 * MEGABYTE)
    with pytest.raises(LogLimitExceeded, match=rf"large\.mcap: byte \d+: .* {MEGABYTE} bytes"):
        open_log(log, ReadLimits(chunk_bytes=MEGABYTE))
    assert run("info", str(log), "--max-chunk", "1M", folder=tmp_path).code == 2
    assert run("info", str(log), "--max-chunk", "3M", folder=tmp_path).code == 0
    with open_log(log, ReadLimits(chunk_bytes=3 * MEGABYTE)) as opened:
        assert sum(opened.counts.values()) == 1


def test_wrong_size_of_a_chunk_is_damage_and_not_a_limit(tmp_path: Path) -> None:
    packed = zstd_with_size(MEGABYTE)
    good = chunk_record(packed, MEGABYTE + ZEROS_HEAD_BYTES)
    log = log_of(tmp_path / "flipped.mcap", chunk_record(packed, 1 << 40), good)
    with open_log(log) as opened:  # the rest can still be read, and repaired
        assert sum(opened.counts.values()) == 0 and "another size" in opened.damage[0]
    with_checksum = chunk_record(packed, MEGABYTE + ZEROS_HEAD_BYTES, checksum=checksum_of(packed))
    log = log_of(tmp_path / "found.mcap", chunk_record(packed, 1 << 40), with_checksum)
    with open_log(log) as opened:
        assert sum(opened.counts.values()) == 1


def checksum_of(packed: bytes) -> int:
    import zlib  # noqa: PLC0415

    return zlib.crc32(zstandard.ZstdDecompressor().decompress(packed))


def test_chunk_of_many_small_messages_takes_no_extra_memory(tmp_path: Path, idle_bytes: int) -> None:
    one = message_record(1, b"")
    data = one * (64 * MEGABYTE // len(one))
    packed = zstandard.ZstdCompressor(level=1).compress(data)
    log = log_of(tmp_path / "many.mcap", chunk_record(packed, len(data)))
    assert log.stat().st_size < 100_000
    ended = run("info", str(log), folder=tmp_path)
    assert ended.code == 0
    assert ended.peak_bytes - idle_bytes < 2 * len(data)


def test_nested_descriptions_that_grow_huge_are_refused(tmp_path: Path, idle_bytes: int) -> None:
    chunks = []
    for number in range(2, 30):
        data = channel_record(number, 1, b"x" * 64 * MEGABYTE)
        chunks.append(chunk_record(zstandard.ZstdCompressor(level=1).compress(data), len(data)))
    log = log_of(tmp_path / "channels.mcap", *chunks)
    assert log.stat().st_size < MEGABYTE
    ended = run("info", str(log), folder=tmp_path)
    assert (
        ended.code == 2 and "schemas and channels of more than" in ended.errors and str(log) in ended.errors
    )
    assert ended.peak_bytes - idle_bytes < 6 * 64 * MEGABYTE  # one of them, and copies while it is read


def test_too_many_channels_are_refused(tmp_path: Path) -> None:
    data = b"".join(channel_record(number, 1, b"/t%d" % number) for number in range(2, 20_000))
    log = log_of(tmp_path / "channels.mcap", chunk_record(zstandard.compress(data), len(data)))
    ended = run("info", str(log), folder=tmp_path)
    assert ended.code == 2 and f"more than {READ_LIMITS.channels} channels" in ended.errors


def test_record_in_a_sparse_file_is_refused(tmp_path: Path) -> None:
    log = log_of(tmp_path / "hole.mcap", struct.pack("<BQ", 0x0C, 1 << 40))
    os.truncate(log, log.stat().st_size + (1 << 40))  # takes no place on the disk
    ended = run("info", str(log), folder=tmp_path)
    assert ended.code == 2 and f"record of {1 << 40} bytes" in ended.errors and "byte " in ended.errors


def test_search_among_thousands_of_false_chunks_ends(tmp_path: Path) -> None:
    count, size = 60_000, len(chunk_record(b"", MEGABYTE))
    content = chunk_record(b"", MEGABYTE, checksum=1)[9 : size - 8]
    places = []
    for number in range(count):  # each reaches to the end of the file, over all that follow
        rest = (count - number - 1) * size
        places.append(struct.pack("<BQ", 6, rest + size - 9) + content + struct.pack("<Q", rest))
    log = log_of(tmp_path / "maze.mcap", struct.pack("<BQ", 9, 1 << 60), b"".join(places))
    started_s = time.monotonic()
    ended = run("info", str(log), folder=tmp_path)
    assert ended.code == 0 and time.monotonic() - started_s < LIMIT_S
    with open_log(log) as opened:
        assert "too many places look like chunks" in " ".join(opened.damage)


def nest(depth: int, line: str, last: str = "int32 x") -> str:
    """Describe a message with others in it, so deep; `line` has N for the number of the inner one."""
    definitions = [line.replace("N", "1")]
    for number in range(1, depth + 1):
        body = line.replace("N", str(number + 1)) if number < depth else last
        definitions.append(f"MSG: zoo_msgs/B{number}\n{body}")
    return f"\n{'=' * 80}\n".join(definitions)


HOSTILE_SCHEMAS = {
    "twice itself, 40 deep": (nest(40, "BN a\nBN b"), "limit"),
    "twice itself, 15 deep": (nest(15, "BN a\nBN b"), "more than 5000 fields"),
    "lists of lists of lists": (nest(30, "BN[] a"), "more than 16 deep"),
    "a chain of 900": (nest(900, "BN a"), "more than 16 deep"),
    "fixed arrays of fixed arrays": (nest(5, "BN[1000] a"), "the limit is"),
    "a large fixed array": ("float64[999999999999] x", "the limit is"),
    "many fields": ("\n".join(f"int32 f{number}" for number in range(6000)), "more than 5000 fields"),
    "a long text": ("# " + "x" * 70 + "\n" + "#\n" * 200_000, "the limit is"),
    "a line of quotes": ('string x "' + '\\"' * 100_000, "the limit is"),
    "blanks before nothing": (" " * 200_000 + "x", "the limit is"),
    "blank lines before nothing": ("\n" * 200_000 + "x", "schema"),
    "a deep default": ("int32[] x " + "[" * 3000, "schema"),
    "a long sum": ("int32 x " + "-" * 3000 + "1", "schema"),
    "a name that is none": (f"int32 x\n{'=' * 80}\nMSG: one\nint32 y", "is not the name of a type"),
}


@pytest.mark.parametrize("name", HOSTILE_SCHEMAS)
def test_hostile_schema_is_refused_quickly(name: str, tmp_path: Path, idle_bytes: int) -> None:
    schema, expected = HOSTILE_SCHEMAS[name]
    data = schema_record(2, b"zoo_msgs/msg/Bad", schema.encode()) + channel_record(2, 2, b"/bad")
    log = log_of(tmp_path / "schema.mcap", data, message_record(2, b"\0\1\0\0" + bytes(64)))
    for words in (["info"], ["export", str(tmp_path / "out")]):
        ended = run(words[0], str(log), *words[1:], folder=tmp_path)
        assert "Traceback" not in ended.errors
        assert ended.code == (1 if words[0] == "export" else 0)
        assert ended.peak_bytes - idle_bytes < 200 * MEGABYTE
    assert "zoo_msgs/msg/Bad" in ended.errors or "zoo_msgs/msg/B" in ended.errors
    assert expected in ended.errors
    with pytest.raises(SchemaError, match=expected):
        message_type_from_schema("zoo_msgs/msg/Bad", schema)


def test_largest_allowed_schema_is_read_quickly() -> None:
    schema = "\n".join(f"float64 a{number}\nstring b{number}" for number in range(2400))
    made = message_type_from_schema("zoo_msgs/msg/Large", schema)
    large: Any = made.decode(made(a7=3.0).encode())
    assert large.a7 == 3.0
    deep = message_type_from_schema("zoo_msgs/msg/Deep", nest(16, "BN[] a"))
    assert deep.decode(deep().encode()) == deep()


def test_carmen_line_without_end_is_refused(tmp_path: Path, idle_bytes: int) -> None:
    with (tmp_path / "long.clf").open("wb") as file:
        file.truncate(8 * GIGABYTE)  # zeros, no end of a line
    ended = run("import-carmen", "long.clf", "new.mcap", folder=tmp_path)
    assert ended.code == 2 and "long.clf:1" in ended.errors and "longest line" in ended.errors
    assert ended.peak_bytes - idle_bytes < 300 * MEGABYTE
    assert not (tmp_path / "new.mcap").exists()


assert sys.platform == "linux"  # ru_maxrss is in kB there
