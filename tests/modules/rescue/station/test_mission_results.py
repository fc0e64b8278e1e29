"""The page shows the results of a mission, and its state and time in the strip."""

import pytest

pytest.importorskip("nicegui", reason="the operator's page needs the extra gui")

from robbie_mp.station.page.state_item import ALERT, GOOD, WARNING
from robbie_robots.modules.rescue.messages import MissionResult, MissionStatus
from robbie_robots.modules.rescue.station.mission_panel import mission_item
from robbie_robots.modules.rescue.station.mission_results import rows_of


def test_results_name_what_is_known_and_leave_out_the_rest() -> None:
    known = MissionResult(
        reason="is home", used_s=271.4, limit_s=600.0, confirmed=3, unconfirmed=1, mapped_m2=38.25,
        searched=0.97, travelled_m=41.2, collisions=2, battery=0.5, notes=["the camera was silent"],
    )  # fmt: skip
    assert rows_of(known) == [
        ("End", "is home"),
        ("Victims", "3 confirmed, 1 more seen"),
        ("Time", "4:31 of 10:00"),
        ("Map", "38.2 m², 97% of its walls searched"),
        ("Way", "41.2 m"),
        ("Collisions", "2"),
        ("Battery", "50% left"),
        ("Note", "the camera was silent"),
    ]
    unknown = dict(rows_of(MissionResult()))
    assert unknown["Collisions"] == "not known, no bumper has reported"
    assert "Battery" not in unknown


@pytest.mark.parametrize(
    ("state", "silent", "text", "look"),
    [
        ("EXPLORE", "", "EXPLORE 1:01 / 10:00", GOOD),
        ("PAUSE", "", "PAUSE 1:01 / 10:00", WARNING),
        ("EXPLORE", "7 s", "EXPLORE 1:01 / 10:00", ALERT),
        ("DONE", "7 s", "DONE 1:01 / 10:00", GOOD),
        ("FAILED", "", "FAILED 1:01 / 10:00", WARNING),
    ],
)
def test_strip_shows_state_and_time_of_the_mission(state: str, silent: str, text: str, look: str) -> None:
    item = mission_item(MissionStatus(state=state, used_s=61.0, limit_s=600.0), silent)
    assert (item.name, item.text, item.look) == ("mission", text, look)


def test_status_from_an_old_log_is_shown_without_a_time() -> None:
    assert mission_item(MissionStatus(state="EXPLORE"), "").text == "EXPLORE"
