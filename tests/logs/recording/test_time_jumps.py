"""Jumps of a log's time are found, in and between chunks, without reading all messages."""

from pathlib import Path

import pytest

from robbie_mp.logs.recording.info import MAX_JUMPS, describe
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.recording.time_jumps import time_jumps
from tests.logs.playback._support.jumps import BEGINNING, FAR, SECOND, SET_BACK, WITHOUT_BATTERY, jumping_log


@pytest.mark.parametrize("chunk_size", [1, 100, 1 << 20])
@pytest.mark.parametrize(
    ("times_ns", "jumps"),
    [
        (WITHOUT_BATTERY, [(4 * SECOND // 10, BEGINNING)]),
        (SET_BACK, [(BEGINNING + SECOND, SECOND)]),
        (FAR, [(BEGINNING + SECOND, (1 << 64) - 2)]),
        ([BEGINNING + at * 600 * SECOND for at in range(4)], []),
    ],
)
def test_jumps_are_found(
    tmp_path: Path, chunk_size: int, times_ns: list[int], jumps: list[tuple[int, int]]
) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", times_ns, chunk_size=chunk_size)) as log:
        assert list(time_jumps(log)) == jumps


def test_description_shows_the_first_jumps_and_counts_the_others(tmp_path: Path) -> None:
    times_ns = [at % 2 * BEGINNING for at in range(100)]
    with open_log(jumping_log(tmp_path / "log.mcap", times_ns)) as log:
        info = describe(log)
    assert len(info.time_jumps) == MAX_JUMPS and info.more_time_jumps == 99 - MAX_JUMPS
    assert str(info.time_jumps[1]).endswith("to 1970-01-01T00:00:00.000Z (1795000000.000 s backwards)")
    assert info.as_data()["time_jumps"][0] == {"before_ns": 0, "after_ns": BEGINNING}
