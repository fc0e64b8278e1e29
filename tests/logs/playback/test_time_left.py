"""The status of a playback says how long the rest takes."""

from robbie_mp.logs.playback.time_left import TimeLeft


def test_time_left_follows_the_pace_since_the_last_change() -> None:
    left = TimeLeft()
    assert left.text("max", now_s=50.0, at_s=10.0, end_s=310.0) == ""
    assert left.text("max", now_s=51.0, at_s=20.0, end_s=310.0) == ""  # too early to know
    assert left.text("max", now_s=60.0, at_s=110.0, end_s=310.0) == "20 s left, "
    assert left.text("rate 1", now_s=61.0, at_s=110.0, end_s=310.0) == ""
    assert left.text("rate 1", now_s=71.0, at_s=120.0, end_s=310.0) == "3 min left, "
    assert left.text("paused", now_s=72.0, at_s=121.0, end_s=310.0) == ""
    assert left.text("paused", now_s=99.0, at_s=121.0, end_s=310.0) == ""
