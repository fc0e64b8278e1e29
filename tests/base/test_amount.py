"""Times and sizes, as people write them."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.base.amount import BadAmount, bytes_of, plain_amount, seconds_of


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2", 2.0), ("0.5", 0.5), (".5s", 0.5), ("300ms", 0.3), ("7 us", 7e-6), ("7µs", 7e-6), ("10ns", 1e-8),
        ("2min", 120.0),
        ("1.5 h", 5400.0), ("1h30min", 5400.0), ("1h 30min 1s", 5401.0), ("2d", 172_800.0), ("1e3", 1000.0),
        ("1e-3s", 0.001), ("2MIN", 120.0),
    ],
)  # fmt: skip
def test_time_is_read(text: str, seconds: float) -> None:
    assert seconds_of(text) == seconds


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("4096", 4096), ("64K", 65_536), ("300M", 300 << 20), ("300 MiB", 300 << 20), ("1.5G", 3 << 29),
        ("2T", 2 << 40),
        ("2kB", 2000), ("1MB", 1_000_000), ("12B", 12), ("1m", 1 << 20),
    ],
)  # fmt: skip
def test_size_is_read(text: str, size: int) -> None:
    assert bytes_of(text) == size


@pytest.mark.parametrize("text", ["", "s", "2m", "1h30", "5 minutes", "nan", "1 2", "2s!", "300M", "--1"])
def test_text_that_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(BadAmount, match=r"expected a time such as 300ms, 2s, .*; got "):
        seconds_of(text)


@pytest.mark.parametrize("text", ["", "M", "3 X", "2min", "nan", "1K2", "300Mbit"])
def test_text_that_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(BadAmount, match="expected a size such as"):
        bytes_of(text)


@given(st.text(alphabet="0123456789.eE+- µusmhdinkKMGTiB", max_size=12))
def test_any_text_is_read_or_refused(text: str) -> None:
    for read in (seconds_of, bytes_of):
        with contextlib.suppress(BadAmount):
            assert isinstance(read(text), float | int)


@given(st.integers(0, 10**9))
def test_whole_milliseconds_are_exact(count: int) -> None:
    assert seconds_of(f"{count}ms") == count / 1000


def test_number_is_in_the_unit_of_the_name() -> None:
    assert plain_amount("period_s", "20ms") == 0.02
    assert plain_amount("slice_ms", "2ms") == 2.0
    assert plain_amount("spin_us", "1ms") == 1000.0
    assert plain_amount("limit_bytes", "1K") == plain_amount("bytes", "1K") == 1024
    assert plain_amount("gain", "2s") is plain_amount("s", "2s") is None
