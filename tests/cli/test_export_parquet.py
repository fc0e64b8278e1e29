"""`robbie export --parquet`: Apache Arrow reads again what was in the log."""

import errno
import os
import sys
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from pyarrow import parquet

from robbie_mp import Array, Message, float64, uint8, uint32
from robbie_mp.cli import main
from robbie_mp.logs.recording import parquet as written
from robbie_mp.logs.recording.parquet import ParquetLibrary, ParquetTable
from robbie_mp.messages import LaserScan, TFMessage, TransformStamped, stock_registry
from tests.logs.recording._support.logs import LogFile, scan


class Nothing(Message, name="team_msgs/msg/Nothing", version=1):
    """Has no fields."""


class Odd(Message, name="team_msgs/msg/Odd", version=1):
    sequence: uint32
    data: Array[uint8]
    gains: Array[float64, Literal[2]]
    names: list[str]
    nothings: list[Nothing]


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def exported(*messages: Message) -> Any:
    """Export messages of one type; return the table that Arrow reads."""
    with LogFile(Path("a.mcap")) as log:
        for number, message in enumerate(messages):
            log.add(message, "it", time_ns=number)
    assert main(["export", "a.mcap", "out", "--parquet", "--strict"]) == 0
    return parquet.read_table("out/it.parquet")


def test_each_message_is_a_row_and_arrays_are_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(written, "GROUP_BYTES", 300)  # so that there are several groups
    table = exported(*(scan(number, rays=number) for number in range(20)))
    assert parquet.ParquetFile("out/it.parquet").num_row_groups > 2
    assert table["time_ns"].to_pylist() == list(range(20))
    assert table["ranges"].to_pylist() == [[number] * number for number in range(20)]
    assert table.schema.field("ranges").metadata[b"unit"] == b"m"
    assert table["header.stamp.sec"].to_pylist() == [scan(number).header.stamp.sec for number in range(20)]


def test_lists_of_messages_are_lists_of_structures() -> None:
    several = [TransformStamped(child_frame_id=name) for name in "ab"]
    table = exported(TFMessage(transforms=several), TFMessage())
    first, second = table["transforms"].to_pylist()
    assert [one["child_frame_id"] for one in first] == ["a", "b"] and second == []
    assert first[0]["transform"]["rotation"]["w"] == 1.0


def test_bytes_fixed_arrays_and_odd_names_are_kept() -> None:
    odd = Odd(
        sequence=7,
        data=np.array([1, 255], np.uint8),
        gains=np.array([0.5, 2.0]),
        names=["", "é"],
        nothings=[Nothing(), Nothing()],
    )
    (row,) = exported(odd).to_pylist()
    assert (row["sequence"], row["message.sequence"]) == (1, 7)
    assert (row["data"], row["gains"], row["names"]) == (b"\x01\xff", [0.5, 2.0], ["", "é"])
    assert row["nothings"] == [None, None]


def test_every_stock_type_can_be_written() -> None:
    library = ParquetLibrary()
    for message_type in stock_registry():
        file = BytesIO()
        with ParquetTable(library, message_type, file, {}) as table:
            for number in range(3):
                table.add(number, number, message_type(), 1)
        assert parquet.read_table(file).num_rows == 3, message_type.type_name


class FullDisk(BytesIO):
    """Has no room after some bytes."""

    def write(self, data: Any) -> int:
        if self.tell() > 2000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


def test_full_disk_is_an_error_once() -> None:
    scans = [LaserScan(ranges=np.random.default_rng(0).random(1000).astype(np.float32))] * 9
    with (
        pytest.raises(OSError, match="No space left"),
        ParquetTable(ParquetLibrary(), LaserScan, FullDisk(), {}) as table,
    ):
        for number, message in enumerate(scans):
            table.add(number, number, message, 4000)


def test_without_arrow_the_command_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with LogFile(Path("a.mcap")) as log:
        log.add(scan(0), "it")
    assert main(["export", "a.mcap", "out", "--parquet"]) == 2
    assert "Parquet files need the extra `parquet`: pip install " in capsys.readouterr().err
    assert not Path("out").exists()
