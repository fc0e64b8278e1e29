"""In a real browser: the track on the floor of the picture, and orders to drive to a place in it."""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page

from robbie_mp.scene import RigidTransform
from robbie_robots.hw.camera import CameraGeometry
from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import Robot, robot_in, wait_until
from tests.station._support.browser import LAPTOP, TABLET, browser, needs_chromium, page_of
from tests.station._support.floor_robot import EYE_M, ROBOT, info, mount
from tests.station.test_driving import Journal
from tests.station.test_page import address_of

pytest.importorskip("nicegui", reason="the operator's page needs the extra gui")

from robbie_mp.station.floor.camera_model import CameraModel

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      tabs: {camera: "", map: ""}
      robot_size_m: [0.5, 0.4, 0.3]
      operator_token: file:operator.token
      observer_token: file:observer.token
      layouts: {Both: {camera: [0, 0, 16, 24], map: [16, 0, 8, 24]}}
  robot: {class: "zoo.floor_robot:FloorRobot"}
"""
OPERATOR, OBSERVER = "operator-operator-1", "observer-observer-1"
MODEL = CameraModel.of(info())
X_MB = RigidTransform.from_rpy((*ROBOT[:2], 0.0), (0.0, 0.0, ROBOT[2]))
HALF_WIDTH_M = 0.2
POINT = re.compile(r"([ML])(\S+) ([\d.]+)")
SEEN = (0.5, 0.6)
"""A place in the picture, in shares of its width and height, where there is floor."""
MIN_TARGET_PX = 44
NOTE = ".q-notification"


class FloorTest:
    """The robot, and a page of it."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def becomes(self, **values: Any) -> None:
        """Change what differs from the usual robot."""
        there = self.robot.folder / "floor.json.new"
        there.write_text(json.dumps(values))
        there.rename(self.robot.folder / "floor.json")

    def told(self, what: str) -> list[list[str]]:
        file = self.robot.output / "floor.txt"
        lines = file.read_text().splitlines() if file.exists() else []
        return [line.split()[1:] for line in lines if line.split()[0] == what]

    def open(self, started: Browser, device: dict[str, Any] = LAPTOP, token: str = OPERATOR) -> Any:
        link = re.sub(r"token=.*", f"token={token}", address_of(self.robot))
        address = link if "token=" in link else f"{link}login?token={token}"
        return page_of(started, address, device)


@pytest.fixture(autouse=True, scope="module")
def nothing_left_behind() -> Iterator[None]:
    """Check once, after all tests, which share a robot and a browser."""
    with leaving_nothing_behind():
        yield


@pytest.fixture(scope="module")
def started(nothing_left_behind: None) -> Iterator[Browser]:
    """The browser of all tests."""
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def standing(nothing_left_behind: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with robot_in(tmp_path_factory.mktemp("floor")) as robot:
        (robot.folder / "zoo" / "floor_robot.py").write_text(
            (HERE / "_support" / "floor_robot.py").read_text()
        )
        robot.write_secret("operator.token", OPERATOR)
        robot.write_secret("observer.token", OBSERVER)
        robot.write_profile(PROFILE)
        robot.start()
        yield robot


@pytest.fixture
def floor(standing: Robot) -> FloorTest:
    made = FloorTest(standing)
    made.becomes()
    return made


def shares(places: Any, pan_rad: float = 0.0) -> NDArray[np.float64]:
    """Return where places on the floor, m in base_link, are in a picture: shares of its width and height."""
    points = np.pad(np.asarray(places, float), ((0, 0), (0, 1)))
    return (MODEL.project(mount(pan_rad).inverse().apply(points)) + 0.5) / (MODEL.width, MODEL.height)


def drawn(page: Page, name: str) -> list[NDArray[np.float64]]:
    """Return the lines that a page has drawn, each as (N, 2) shares."""
    lines: list[list[tuple[float, float]]] = []
    for kind, across, down in POINT.findall(page.get_attribute(f".floor path.{name}", "d") or ""):
        if kind == "M":
            lines.append([])
        lines[-1].append((float(across), float(down)))
    return [np.array(line) for line in lines]


def edge(linear: float, angular: float, side_m: float) -> list[list[float]]:
    """Return an edge of the way of a robot that drives on, by small steps; m in base_link."""
    x_m = y_m = turn_rad = 0.0
    places, step_s = [[x_m, side_m]], 1e-4
    for number in range(1, round(3.0 / abs(linear) / step_s)):
        turn_rad += angular * step_s
        x_m += linear * step_s * math.cos(turn_rad)
        y_m += linear * step_s * math.sin(turn_rad)
        if number % 100 == 0:
            places.append([x_m - side_m * math.sin(turn_rad), y_m + side_m * math.cos(turn_rad)])
    return places


def distance_to(line: NDArray[np.float64], points: NDArray[np.float64]) -> float:
    """Return the greatest distance of points from a line's points."""
    return float(np.hypot(*np.moveaxis(points[:, None] - line[None], -1, 0)).min(axis=1).max())


@pytest.mark.parametrize(
    ("drive", "pan_rad", "camera"),
    [
        ((0.5, 0.0), 0.0, "eye"),
        ((0.5, 0.3), 0.0, "eye"),
        ((0.4, -0.2), 0.3, "eye"),
        ((-0.3, 0.1), 0.0, "rear"),
    ],
)
def test_track_is_drawn_where_the_robot_will_be(
    floor: FloorTest, started: Browser, drive: tuple[float, float], pan_rad: float, camera: str
) -> None:
    mode = 1 if camera == "rear" else 0  # the picture behind is the large one while an operator drives back
    floor.becomes(drive=drive, pan_rad=pan_rad, mode=mode)
    look_rad = math.pi if camera == "rear" else pan_rad
    edges = [shares(edge(*drive, side), look_rad) for side in (-HALF_WIDTH_M, HALF_WIDTH_M)]
    seen = [line[~np.isnan(line).any(axis=1)] for line in edges]
    with floor.open(started) as page:
        page.wait_for_selector(f".hud-name:text-is('{camera}')")
        page.wait_for_selector(".floor path.track", state="attached")

        def is_right() -> bool:
            lines = drawn(page, "track")[:2]
            return len(lines) == 2 and all(
                len(line) > 5 and distance_to(expected, line) < 0.01
                for line, expected in zip(lines, seen, strict=True)
            )

        wait_until(is_right)
        assert page.locator("#floor-why").count() == 0


def test_nothing_is_drawn_without_calibration_and_the_page_says_why(
    floor: FloorTest, started: Browser
) -> None:
    floor.becomes(drive=(0.5, 0.0), calibrated=False)
    with floor.open(started) as page:
        page.wait_for_selector("#floor-why:has-text('the camera is not calibrated')")
        assert page.locator(".floor path").count() == 0
        floor.becomes(
            drive=(0.5, 0.0), late_s=-1.0
        )  # a picture from before anybody tells where its camera is
        page.wait_for_selector("#floor-why:has-text('where the camera was at that moment is not known')")
        assert page.locator(".floor path").count() == 0
        floor.becomes(drive=(0.5, 0.0))
        page.wait_for_selector(".floor path.track", state="attached")


def pressed(page: Page, across: float, down: float, delay_ms: float = 0.0) -> None:
    """Press a place in the picture, as a finger or a mouse does."""
    box = page.locator(".camera-picture").bounding_box()
    assert box
    at = box["x"] + across * box["width"], box["y"] + down * box["height"]
    page.mouse.click(*at, delay=delay_ms)


def floor_at(across: float, down: float) -> NDArray[np.float64]:
    """Return the place on the map that the picture shows there."""
    ray = MODEL.ray(across * MODEL.width - 0.5, down * MODEL.height - 0.5)
    X_BC = mount(0.0)
    towards = X_BC.apply(ray[None])[0] - X_BC.translation
    place = X_BC.translation - towards * (EYE_M[2] / towards[2])
    return X_MB.apply(place)[:2]


def proposed(page: Page, across: float = SEEN[0], down: float = SEEN[1]) -> None:
    """Press a place until a way there is proposed: a page that has just come to the front may miss it."""
    page.wait_for_selector(".camera-picture .picture-age")
    page.wait_for_function("window.did_handshake && window.socket.connected")
    page.wait_for_selector(".floor")
    page.wait_for_function("window.picture_to_drive_by")
    pressed(page, across, down)
    page.wait_for_selector("#floor-go")


def settled(page: Page) -> None:
    """Wait until a second press counts."""
    page.wait_for_timeout(600)


@pytest.mark.parametrize("device", [LAPTOP, TABLET], ids=["laptop", "tablet"])
def test_first_press_shows_the_way_and_the_second_one_drives_it(
    floor: FloorTest, started: Browser, device: dict[str, Any]
) -> None:
    goals = len(floor.told("goal"))
    expected = floor_at(*SEEN)
    with floor.open(started, device) as page:
        proposed(page)
        x, y, *eye = map(float, floor.told("plan")[-1])
        assert (x, y) == pytest.approx(expected, abs=0.03)
        assert eye == pytest.approx(X_MB.apply(EYE_M)[:2], abs=0.01)
        way, ring = drawn(page, "way")
        assert way[-1] == pytest.approx(SEEN, abs=0.02)
        assert ring.mean(axis=0) == pytest.approx(SEEN, abs=0.03)
        page.wait_for_selector("#floor-card:has-text('m to drive')")
        if device is LAPTOP:
            page.wait_for_selector("#map-text:has-text('1 proposed goals')")
        for button in ("#floor-go", "#floor-cancel"):
            box = page.locator(button).bounding_box()
            assert box and min(box["width"], box["height"]) >= MIN_TARGET_PX
        assert len(floor.told("goal")) == goals
        settled(page)
        if device is LAPTOP:
            pressed(page, *SEEN)
        else:
            page.tap("#floor-go")
        wait_until(lambda: len(floor.told("goal")) == goals + 1)
        x_m, y_m, frame = floor.told("goal")[-1]
        assert (float(x_m), float(y_m), frame) == (x, y, "map")
        page.wait_for_selector("#floor-card", state="detached")


def test_double_click_shows_the_way_and_does_not_drive_it(floor: FloorTest, started: Browser) -> None:
    goals = len(floor.told("goal"))
    with floor.open(started) as page:
        proposed(page)
        page.click("#floor-cancel")
        page.wait_for_selector("#floor-card", state="detached")
        page.wait_for_timeout(600)
        page.evaluate("""() => new MutationObserver((_, self) => {
          if (!document.querySelector('#floor-go')) return;
          self.disconnect();
          document.querySelector('#floor-go').click();
          window.has_clicked = true;
        }).observe(document.querySelector('.floor'), { childList: true, subtree: true })""")
        pressed(page, *SEEN)
        page.wait_for_function("window.has_clicked")
        page.wait_for_selector("#floor-go")
        page.wait_for_timeout(500)
        assert len(floor.told("goal")) == goals


def test_press_elsewhere_or_cancel_or_a_drag_drives_nothing(floor: FloorTest, started: Browser) -> None:
    goals = len(floor.told("goal"))
    with floor.open(started) as page:
        proposed(page)
        settled(page)
        pressed(page, 0.2, 0.9)
        page.wait_for_selector("#floor-card", state="detached")
        page.wait_for_timeout(600)
        proposed(page)
        page.click("#floor-cancel")
        page.wait_for_selector("#floor-card", state="detached")
        plans = len(floor.told("plan"))
        box = page.locator(".camera-picture").bounding_box()
        assert box
        page.mouse.move(box["x"] + 100, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 160, box["y"] + 200, steps=3)  # which would turn a camera
        page.mouse.up()
        page.wait_for_timeout(300)
        assert len(floor.told("plan")) == plans
        assert page.locator("#floor-card").count() == 0
        assert len(floor.told("goal")) == goals


@pytest.mark.parametrize(
    ("values", "at", "why"),
    [
        ({"down_rad": 0.2}, (0.5, 0.1), "above the horizon: press a place on the floor"),
        ({"down_rad": 0.2}, (0.5, 0.345), "press a place nearer than 5.9 m"),
        ({"late_s": 2.5}, SEEN, "s old: press in a newer one"),
        ({"calibrated": False}, SEEN, "the camera is not calibrated"),
        ({"has_pose": False}, SEEN, "the robot's position on the map is"),
        ({"refuses": "a wall stands there"}, SEEN, "the way was refused: a wall stands there"),
    ],
)
def test_what_is_no_goal_is_refused_in_a_sentence(
    floor: FloorTest, started: Browser, values: dict[str, Any], at: tuple[float, float], why: str
) -> None:
    goals = len(floor.told("goal"))
    with floor.open(started) as page:
        proposed(page)
        page.click("#floor-cancel")
        floor.becomes(**values)
        page.wait_for_timeout(2500)  # until what was is old, and a press is not too quick
        pressed(page, *at)
        page.wait_for_selector(f'{NOTE}:has-text("{why}")')
        page.wait_for_selector("#floor-card", state="detached")
        assert len(floor.told("goal")) == goals


def test_way_is_withdrawn_when_the_map_is_corrected(floor: FloorTest, started: Browser) -> None:
    goals = len(floor.told("goal"))
    with floor.open(started) as page:
        proposed(page)
        floor.becomes(odom_x_m=0.5)
        page.wait_for_selector(f"{NOTE}:has-text('The map was corrected')")
        page.wait_for_selector("#floor-card", state="detached")
        assert len(floor.told("goal")) == goals
        page.wait_for_timeout(600)
        proposed(page)
        x, y, *_ = map(float, floor.told("plan")[-1])
        assert (x, y) == pytest.approx((floor_at(*SEEN) + np.array([0.5, 0.0])), abs=0.03)


def test_place_is_chosen_by_the_keyboard_and_escape_only_cancels(floor: FloorTest, started: Browser) -> None:
    goals = len(floor.told("goal"))
    with floor.open(started) as page:
        page.wait_for_function("window.did_handshake && window.socket.connected")
        page.wait_for_function("window.picture_to_drive_by")
        page.keyboard.press("j")
        page.wait_for_selector("#floor-aim:focus")
        for key in ("ArrowUp", "ArrowUp", "ArrowLeft"):
            page.keyboard.press(key)
        page.keyboard.press("Enter")
        page.wait_for_selector("#floor-go:focus")
        x, y, *_ = map(float, floor.told("plan")[-1])
        assert (x, y) == pytest.approx(floor_at(0.48, 0.76), abs=0.03)
        page.keyboard.press("Escape")
        page.wait_for_selector("#floor-card", state="detached")
        page.wait_for_selector("#floor-aim:focus")
        assert page.locator("#emergency-stop-state:text-matches('stopping|STOPPED|NOT')").count() == 0
        page.wait_for_timeout(600)
        page.keyboard.press("Enter")
        page.wait_for_selector("#floor-go:focus")
        settled(page)
        page.keyboard.press("Enter")
        wait_until(lambda: len(floor.told("goal")) == goals + 1)


def test_escape_stops_the_robot_as_always_after_a_press_by_hand(floor: FloorTest, started: Browser) -> None:
    with floor.open(started) as page:
        proposed(page)
        page.keyboard.press("Escape")
        page.wait_for_selector("#floor-card", state="detached")
        page.wait_for_selector("#emergency-stop-state:text-matches('stopping|NOT CONFIRMED')")


def test_two_operators_see_each_others_ways_and_drive_only_their_own(
    floor: FloorTest, started: Browser
) -> None:
    goals = len(floor.told("goal"))
    with floor.open(started) as page, floor.open(started) as other:
        proposed(page)
        other.wait_for_selector("#map-text:has-text('1 proposed goals')")
        assert other.locator("#floor-card").count() == 0
        proposed(other, 0.3, 0.7)
        page.wait_for_selector("#map-text:has-text('2 proposed goals')")
        settled(other)
        other.click("#floor-go")
        wait_until(lambda: len(floor.told("goal")) == goals + 1)
        x_m, y_m, _ = floor.told("goal")[-1]
        assert (float(x_m), float(y_m)) == pytest.approx(floor_at(0.3, 0.7), abs=0.03)
        assert page.is_visible("#floor-go")


def test_observer_sees_the_track_and_can_press_nothing(floor: FloorTest, started: Browser) -> None:
    floor.becomes(drive=(0.5, 0.0))
    plans = len(floor.told("plan"))
    with floor.open(started, token=OBSERVER) as page:
        page.wait_for_selector(".floor path.track", state="attached")
        pressed(page, *SEEN)
        page.wait_for_timeout(500)
        assert page.locator("#floor-aim").count() == 0
        assert len(floor.told("plan")) == plans


def test_page_says_when_a_goal_waits_for_go_on(floor: FloorTest, started: Browser) -> None:
    floor.becomes(mode=2)
    with floor.open(started) as page:
        proposed(page)
        settled(page)
        page.click("#floor-go")
        page.wait_for_selector(f"{NOTE}:has-text('as soon as it is told to go on')")


SIMULATED = """
parents: [robbie:navigation]
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0, tabs: {camera: ""}}}
  scene_graph:
    class: robbie_mp.scene.module:SceneGraphService
    settings: {file: "robbie:hw/robots/rescue.yaml"}
  pan_tilt: {class: "robbie_robots.modules.devices.pan_tilt:SimulatedPanTiltModule"}
  camera:
    class: robbie_robots.modules.devices.camera:SimulatedCameraModule
    settings: {arena: "robbie:hw/simulation/arenas/demo.yaml", period_s: 0.2}
  witness: {class: "zoo.witness:Witness"}
"""
START_X_M, SEEN_BELOW = 0.0, 0.85
TOLERANCE_M = 0.35
"""Navigation's own, and an error of the place."""


@pytest.mark.alone
def test_robot_drives_to_the_place_that_was_pressed(robot: Robot, started: Browser) -> None:
    """With the real camera model, mapping and navigation, and the true pose of the simulation."""
    (robot.folder / "zoo" / "witness.py").write_text((HERE / "_support" / "witness.py").read_text())
    robot.write_profile(SIMULATED)
    robot.start()
    journal, geometry = Journal(robot), CameraGeometry()
    slope = (SEEN_BELOW * geometry.height - 0.5 - geometry.centre_px[1]) / geometry.focal_length_px
    goal_x_m = START_X_M + geometry.mount_m[0] + geometry.mount_m[2] / slope
    assert goal_x_m > START_X_M + 1.0
    with page_of(started, address_of(robot)) as page:
        page.wait_for_selector(".camera-picture .picture-age")
        page.wait_for_function("window.picture_to_drive_by")
        for _ in range(20):  # until mapping, navigation and camera are all there, also on a busy machine
            pressed(page, 0.5, SEEN_BELOW)
            page.wait_for_selector(f"#floor-go, {NOTE}")
            if page.is_visible("#floor-go"):
                break
            page.wait_for_selector(NOTE, state="detached")  # it has said why not
        settled(page)
        assert journal.rows("odometry")[-1][1] == pytest.approx(
            START_X_M, abs=0.01
        )  # not before it is told to
        page.click("#floor-go")
        page.wait_for_selector(f"{NOTE}:has-text('the robot is at the goal')")
        wait_until(lambda: journal.speed() == 0.0)
        assert journal.rows("odometry")[-1][1] == pytest.approx(goal_x_m, abs=TOLERANCE_M)
