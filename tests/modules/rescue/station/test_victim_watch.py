"""Victims in a log are events, one for each change of their state; and marks with pictures."""

import math
from pathlib import Path

import pytest

from robbie_mp.messages import Image, Mark, Pose, Quaternion
from robbie_mp.station.map.marks import MarkPicture
from robbie_mp.station.page.log_events import LogEvents
from robbie_robots.modules.rescue.messages import VictimFound
from robbie_robots.modules.rescue.station.mission_panel import MissionPanel
from robbie_robots.modules.rescue.station.victim_list import place_before
from robbie_robots.modules.rescue.station.victim_watch import KnownVictim, mark_of
from tests._support.robot import wait_until
from tests.logs.recording._support.logs import LogFile


def test_each_change_of_a_victims_state_is_an_event(tmp_path: Path) -> None:
    states = [VictimFound.SUSPECTED, VictimFound.SUSPECTED, VictimFound.CONFIRMED]
    with LogFile(tmp_path / "log.mcap") as log:
        for state in states:
            log.add(VictimFound(id=7, name="tag 7", state=state))
        log.add(VictimFound(id=8, state=VictimFound.SUSPECTED))
        log.add(Mark(text="here"))
    events = LogEvents(MissionPanel.log_events)
    events.read(str(tmp_path / "log.mcap"))
    wait_until(lambda: bool(events.found or events.error))
    found = [(event.kind.name, event.text) for event in events.found]
    assert found == [
        ("victim", "tag 7 suspected"),
        ("victim", "tag 7 confirmed"),
        ("victim", "8 suspected"),
        ("mark", "here"),
    ]


def known(state: int, image: Image, image_count: int = 3) -> KnownVictim:
    pose = Pose(orientation=Quaternion.from_yaw(1.5))
    found = VictimFound(id=7, name="tag 7", state=state, pose=pose, image=image)
    return KnownVictim(found, 0.0, 5, image_count, 0.0, 0.0)


def test_robot_that_is_sent_to_a_victim_stands_before_its_wall_and_looks_at_it() -> None:
    pose = place_before(known(VictimFound.CONFIRMED, Image())).pose
    way = (pose.position.x, pose.position.y)
    assert way == pytest.approx((0.6 * math.cos(1.5), 0.6 * math.sin(1.5)))
    assert pose.orientation.yaw == pytest.approx(1.5 - math.pi)


@pytest.mark.parametrize("state", [VictimFound.ASKED, VictimFound.CONFIRMED])
def test_victim_that_was_asked_about_has_its_newest_picture_at_the_wall(state: int) -> None:
    image = Image(width=64, height=48)
    assert mark_of(known(state, image)).picture == MarkPicture("/pictures/victim/7?3", 1.5, 0.75)
    assert mark_of(known(state, image)) == mark_of(known(state, image))
    assert mark_of(known(state, image)) != mark_of(known(state, image, image_count=4))


@pytest.mark.parametrize(
    ("state", "image"), [(VictimFound.SUSPECTED, Image(width=64, height=48)), (VictimFound.ASKED, Image())]
)
def test_victim_that_is_only_suspected_or_has_no_image_has_no_picture(state: int, image: Image) -> None:
    assert mark_of(known(state, image)).picture is None
