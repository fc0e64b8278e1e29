"""The age of a message is shown only if it exceeds its maximum."""

import pytest

from robbie_mp.station.watch.latest import silence


@pytest.mark.parametrize(
    ("age_s", "text"),
    [
        (None, ""),
        (0.0, ""),
        (2.0, ""),
        (2.6, "3 s"),
        (119.0, "119 s"),
        (121.0, "2 min"),
        (7199.0, "120 min"),
        (7300.0, "2 h"),
    ],
)
def test_duration_of_silence_is_readable(age_s: float | None, text: str) -> None:
    assert silence(age_s, 2.0) == text
