"""In a real browser, each panel shows the robot's data, and its messages reach the robot."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page

from robbie_mp.cli.runs import live_runs
from robbie_mp.messages import Mark
from robbie_mp.run.trace.kinds import Kind, read_recorded
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS
from tests._support.robot import LIMIT_S, Robot, wait_until
from tests.logs.recording._support.logs import LogFile
from tests.station._support.browser import (
    ATTEMPT_MS,
    ATTEMPTS,
    HELD_MS,
    IS_CONNECTED,
    LAPTOP,
    TABLET,
    begin_drawing,
    browser,
    choose_layout,
    needs_chromium,
    open_panel,
    page_of,
    press_until,
)
from tests.station._support.known_robot import FRONTIERS
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(600)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      observer_token: file:observer.token
      poses: {wave: {wrist: 0.5}}
      speech_commands: [come here]
      persons: [Anna]
      objects: [cup]
  known: {class: "zoo.known_robot:KnownRobot"}
  fragile: {class: "zoo.known_robot:Fragile"}
  link: {class: "robbie_mp.connect.link.module:Link", settings: {robot: red, listen: [], prefix_topics: true}}
  arm:
    class: robbie_robots.modules.devices.joints:SimulatedJointsModule
    settings: {names: [wrist], period_s: 0.1}
"""

DRIVING_KEYS = ("KeyW", "KeyA", "ArrowUp", "ArrowDown")
IN_MENU = "document.querySelector('#map-drawings')?.contains(document.activeElement)"
COUNT = """() => {
  window.driven = 0;
  const count = ({ detail: { linear, angular } }) => (window.driven += linear || angular ? 1 : 0);
  addEventListener("robbie-driven", count);
}"""
"""Counts how often the page asks for motion."""
FITS = """panel => [document.documentElement, document.getElementById(panel)].every(
  one => one.scrollWidth <= one.clientWidth)"""
"""Once its letters have been loaded: before, icons are words."""
SCROLLS = """(panel) => {
  const { scrollHeight, clientHeight } = document.querySelector(panel);
  return scrollHeight > clientHeight;
}"""
DEPTHS = """() => {
  const image = document.querySelector("#panel-cameras img[alt='camera range']");
  if (!image?.naturalWidth) return null;
  const pen = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  pen.drawImage(image, 0, 0);
  const near = (level) => [0, 40, 255].find((one) => Math.abs(one - level) < 20) ?? level;
  return [0, 2, 3].map((x) => near(pen.getImageData(x, 0, 1, 1).data[0]));
}"""
"""Returns the brightness of the nearest, the farthest and an unmeasured depth, but for the losses of JPEG."""
FOX_IS_IN_ITS_PLACE = """() => {
  const picture = document.querySelector("#panel-cameras img").getBoundingClientRect();
  const fox = document.querySelector(".detection-boxes > div").getBoundingClientRect();
  const shares = [(fox.x - picture.x) / picture.width, (fox.y - picture.y) / picture.height,
    fox.width / picture.width, fox.height / picture.height];
  return [0.5, 0.25, 0.5, 0.5].every((share, at) => Math.abs(share - shares[at]) < 0.02);
}"""


@pytest.fixture
def told(robot: Robot) -> "Told":
    return Told(robot)


class Told:
    """The messages that the robot received."""

    def __init__(self, robot: Robot):
        self._file = robot.output / "told.txt"

    def waits_for(self, *words: str, limit_s: float = LIMIT_S) -> list[str]:
        """Wait until the last thing told begins with these words; return the others."""
        found: list[str] = []

        def is_there() -> bool:
            lines = self._file.read_text().splitlines()
            found[:] = lines[-1].split() if lines else []
            return found[: len(words)] == list(words)

        wait_until(is_there, limit_s)
        return found[len(words) :]

    def hears(self, page: Page, button: str, *words: str) -> None:
        """Press a button until the robot was told: a page that is connecting again tells nothing."""
        for _ in range(ATTEMPTS):
            page.wait_for_function(IS_CONNECTED)
            page.click(button)
            with suppress(TimeoutError):
                self.waits_for(*words, limit_s=ATTEMPT_MS / 1000)
                return
        raise AssertionError(f"{button} has no effect")

    def count(self, begin: str) -> int:
        """Count the notes that begin with this text."""
        return sum(line.startswith(begin) for line in self._file.read_text().splitlines())


HOLD_BACK = """() => navigator.getGamepads = () => [null, {
  axes: [0, 0, 0, 0], buttons: [...Array(17).keys()].map((at) => ({ pressed: at === 8 })),
}]"""
WAITING = "Object.values(mounted_app.$refs).flat().find((one) => one?.on_screen).waiting"
"""The goals that the map shows beside the one that the robot has."""
MOVE_CAMERA_AND_CLICK = """() => {
  const scene = document.querySelector("#view-scene");
  const { camera } = Object.values(mounted_app.$refs).find((one) => one?.$el === scene);
  camera.position.set(5, 5, 9);
  camera.lookAt(2, 0, 0);
  camera.updateMatrixWorld();
  camera.position.set(-3, 0, 3);
  camera.lookAt(0, 0, 0);
  const canvas = scene.querySelector("canvas");
  const { left, top, width, height } = canvas.getBoundingClientRect();
  const middle = { clientX: left + width / 2, clientY: top + height / 2, bubbles: true };
  canvas.dispatchEvent(new MouseEvent("click", middle));
}"""
"""Lets the camera look at the origin, and clicks there before a frame is drawn."""
NEAR_AND_FAR_WALLS = """() => {
  const moving = Object.values(mounted_app.$refs).find((one) => one?.choose_walls);
  const [near] = moving.blocks.values();
  const far = { mesh: { position: near.mesh.position.clone().addScalar(900) }, count: 1 };
  moving.blocks.set("far", far);
  const { count } = near;
  near.count = 5000;
  const raised = () => (moving.choose_walls(), [near.mesh.visible, far.mesh.visible]);
  const { quality } = moving.effort;
  moving.effort.quality = 0;
  const fine = raised();
  for (let step = 0; step < 9; step += 1) moving.draw_coarser(moving.renderer);
  const coarse = raised();
  moving.blocks.delete("far");
  const ratio = moving.renderer.getPixelRatio();
  moving.effort.quality = quality;
  near.count = count;
  return { fine, coarse, ratio };
}"""


def test_panels_show_the_robot_and_their_messages_reach_it(robot: Robot, told: Told) -> None:
    (robot.folder / "zoo" / "known_robot.py").write_text((HERE / "_support" / "known_robot.py").read_text())
    with LogFile(robot.folder / "old.mcap") as log:
        log.add(Mark(text="here it was"), time_ns=104 * 10**9)
    robot.write_secret("operator.token", "opens-everything")
    robot.write_secret("observer.token", "opens-all-our-eyes")
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address) as page:
        log_in(page, "opens-everything")
        page.wait_for_selector("#layouts:has-text('Playback')")  # because a log plays
        # Tablet has the pad and the map, and no 3-D view, which takes both processors.
        choose_layout(page, 4, "Tablet")
        everything_is_reached_by_keys(page)
        keys_do_not_drive_in_a_menu_and_the_map_has_the_focus_while_one_places(page)
        with page_of(started, address) as other:
            nothing_is_shown_without_a_token(other, address)
            log_in(other, "opens-all-our-eyes")
            observer_sees_and_does_not_steer(other)
        layout_is_changed_and_comes_back(page)
        playback_is_steered(page, told)
        map_is_shown_and_goal_is_set(page, told)
        walls_are_raised_and_goal_is_set_on_the_floor(page, told)
        joint_moves_while_its_pose_is_held(page)
        cameras_are_shown(page)
        commands_of_the_profile_are_given(page, told)
        trace_is_filtered_and_what_is_recorded_is_chosen(page, robot)
        messages_are_shown_and_composed(page, told)
        crash_is_reported(page)
        wishes = messages_are_sent_at_a_rate_until_the_page_goes(page, told, robot)
        everything_fits(page)
        page_is_held_upright(page)
        everything_fits(page)
        page.set_viewport_size(LAPTOP["viewport"])
        assert told.count("wish") == wishes, "it went on without its page"
        image_of_a_silent_camera_shows_its_age(page, robot)
        open_panel(page, "drive")  # and nothing is attached to the robot any more
        robot.until(lambda modules: not any("operator station:" in one["status"] for one in modules.values()))


def log_in(page: Page, token: str) -> None:
    page.fill("#token", token)
    page.keyboard.press("Enter")


def everything_is_reached_by_keys(page: Page) -> None:
    """What stops, drives and leads to the other panels."""
    page.wait_for_selector("#drive-pad")
    wanted = {"emergency-stop", "tab-drive", "drive-pad", "linear-limit", "angular-limit"}
    for _ in range(100):
        page.keyboard.press("Tab")
        wanted.discard(page.evaluate("document.activeElement.closest('[id]')?.id"))
    assert not wanted
    page.focus("#tab-system")
    page.keyboard.press("Enter")
    page.wait_for_selector("#panel-system", state="visible")
    page.wait_for_selector("#drive-pad", state="hidden")
    page.focus("#maximise-system")
    page.keyboard.press("Enter")
    page.wait_for_selector("#drive-pad", state="visible")


def everything_fits(page: Page) -> None:
    """No panel is wider than the page, and nothing hides the emergency stop."""
    for name in FRAMEWORK_PANELS:
        open_panel(page, name)
        page.wait_for_function(FITS, arg=f"panel-{name}")
        page.click("#emergency-stop", trial=True)


def nothing_is_shown_without_a_token(page: Page, address: str) -> None:
    for path in ("live/map", "pictures/still/x", "tile/drive"):
        assert page.request.get(address + path).status == 401


def layout_is_changed_and_comes_back(page: Page) -> None:
    """Tiles are moved and removed; a page that is loaded later has them there."""
    page.click("#close-map")
    page.wait_for_selector("#tile-map", state="hidden")
    box = page.locator("#tile-drive .tile-head .title").bounding_box()
    assert box
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 5, steps=5)
    page.mouse.move(box["x"] + 900, box["y"] - 300, steps=5)
    page.mouse.up()
    page.wait_for_selector("#tile-drive:not(.ui-draggable-dragging):not([gs-x='0'])")
    at = f"#tile-drive[gs-x='{page.get_attribute('#tile-drive', 'gs-x')}']"
    page.reload()
    page.wait_for_selector(at)
    assert not page.locator("#tile-map").is_visible()
    page.click("#layouts")
    page.click("#layout-reset")
    page.wait_for_selector("#tile-map", state="visible")
    page.click("#layouts")
    page.click("#layout-save-as")
    page.fill("#layout-name", "Mine")
    page.keyboard.press("Enter", delay=HELD_MS)
    page.wait_for_selector("#layouts:has-text('Mine')")
    page.click("#layouts")
    page.click("[data-layout=Engineer]")
    page.wait_for_selector("#panel-system", state="visible")
    page.wait_for_selector("#drive-pad", state="hidden")
    with page.expect_popup() as opened:
        page.click("#pop-out-trace")
    opened.value.wait_for_selector("#panel-trace")
    assert opened.value.locator("#panels, #tile-system").count() == 0
    opened.value.click("#emergency-stop", trial=True)
    opened.value.close()
    page.bring_to_front()


def page_is_held_upright(page: Page) -> None:
    """The layout for pages that are higher than wide is another one."""
    choose_layout(page, 4, "Tablet")
    page.wait_for_selector("#tile-map[gs-x='15']")
    page.set_viewport_size(TABLET["viewport"])
    page.wait_for_selector("#tile-map[gs-y='9']")


def keys_do_not_drive_in_a_menu_and_the_map_has_the_focus_while_one_places(page: Page) -> None:
    page.evaluate(COUNT)
    page.click("#map-draw")
    page.wait_for_function(IN_MENU)
    for key in DRIVING_KEYS:
        page.keyboard.down(key)
        page.keyboard.up(key)
    assert page.evaluate(IN_MENU)
    assert page.evaluate("window.driven") == 0
    page.click("#map-draw-place")
    map_has_the_focus(page, "place")
    page.click("#map-mode >> text=Set goal")
    map_has_the_focus(page, "goal")
    page.click("#map-mode >> text=Move")
    page.keyboard.down("KeyW")  # which shows that keys drive, and are counted
    page.wait_for_function("window.driven > 0")
    page.keyboard.up("KeyW")


def map_has_the_focus(page: Page, what: str) -> None:
    page.wait_for_selector(f"#map-view[data-placing={what}]")
    page.wait_for_function("document.activeElement.id == 'map-view'")


def observer_sees_and_does_not_steer(page: Page) -> None:
    page.wait_for_selector("#role:text-is('observer')")
    page.wait_for_selector("#playback-text:has-text('PLAYBACK of old.mcap')")
    open_panel(page, "map")
    page.wait_for_selector("#map-text:has-text('robot at 1.50 m')")
    open_panel(page, "messages")
    page.wait_for_selector("#messages-topics tr:has-text('map_pose')")
    for steers in ("#map-mode", "#map-cancel", "#playback-pause", "#messages-compose", "#drive-pad", "#mark"):
        assert not page.locator(steers).is_visible(), steers


def playback_is_steered(page: Page, told: Told) -> None:
    page.wait_for_selector("#playback-text:has-text('PLAYBACK of old.mcap: plays at 3.000 of 10.000 s')")
    told.hears(page, "#playback-pause", "control", "pause")
    page.wait_for_selector("#playback-text:has-text('paused at 3.000')")
    told.hears(page, "#playback-step", "control", "step")
    told.hears(page, "#playback-resume", "control", "resume")
    slider = page.locator("#playback .q-slider")
    box = slider.bounding_box()
    assert box
    slider.click(position={"x": box["width"] * 0.8, "y": box["height"] / 2})
    (sought_s,) = told.waits_for("control", "seek")
    assert float(sought_s) == pytest.approx(8.0, abs=0.2)
    page.wait_for_selector(f"#playback-text:has-text('plays at {float(sought_s):.3f}')")
    page.click("#playback-rate")
    page.click(".q-menu .q-item:has-text('max')")
    assert told.waits_for("control", "rate") == ["inf"]
    page.wait_for_selector("#playback-text:has-text('as fast as possible')")
    page.click("#playback-events [data-at='4.000'][title='here it was, at 4.0 s']")
    assert told.waits_for("control", "seek") == ["4.0"]
    page.click("#mark")
    assert told.waits_for("mark") == ["mark", "1"]
    page.evaluate(HOLD_BACK)
    told.waits_for("mark", "mark", "2")


def map_is_shown_and_goal_is_set(page: Page, told: Told) -> None:
    open_panel(page, "map")
    page.wait_for_selector("#map-text:has-text('12 x 8 cells of 0.5 m; robot at 1.50 m, 3.25 m, 90°')")
    page.wait_for_selector("#map-text:has-text('path of 1201 points; 2 frontiers; home')")
    page.click("#map-fit")
    page.click("#map-mode >> text=Set goal")
    page.wait_for_selector("#map-view[data-placing=goal][data-map=whole]")
    page.click("#map-view")  # its middle, which is that of all known cells
    frame, *place = told.waits_for("goal")
    # Where the robot at (1.5, 3.25) would look on its way to (2, 3.75).
    assert frame == "map"
    assert [float(word) for word in place] == pytest.approx([2.0, 3.75, np.pi / 4], abs=0.05)
    page.wait_for_selector("#map-text:has-text('goal at 2.0')")
    picture = saved_map(page, (0, 0), (46, 125, 50))  # the goal
    refusal_and_cancel_of_a_goal_are_shown(page, told)
    middle_x, middle_y = picture.width // 2, picture.height // 2
    pixels_per_m = 0.9 * picture.height / 3.5
    wall = (middle_x - round(2.75 * pixels_per_m), middle_y + round(0.75 * pixels_per_m))
    assert picture.getpixel(wall) == (0, 0, 0)
    for frontier in FRONTIERS:
        x = middle_x + round((frontier.x - 2.0) * pixels_per_m)
        y = middle_y - round((frontier.y - 3.75) * pixels_per_m)
        assert picture.getpixel((x, y)) == (142, 36, 170), f"the frontier at {frontier} is not drawn there"
    free = (middle_x - round(2.25 * pixels_per_m), wall[1])
    assert picture.getpixel(free) == (255, 255, 255)
    unknown = (wall[0], middle_y - round(1.85 * pixels_per_m))
    assert picture.getpixel(unknown) == (170, 170, 170)
    home = (middle_x - round(1.5 * pixels_per_m), middle_y + round(1.25 * pixels_per_m))
    assert picture.getpixel(home) == (57, 73, 171)
    costs_are_shown_on_request(page, (round(2.75 * pixels_per_m), round(1.5 * pixels_per_m)))
    page.click("#map-in")
    further = (round(1.5 * (wall[0] - middle_x)), round(1.5 * (wall[1] - middle_y)))
    saved_map(page, further, (0, 0, 0))
    page.click("#map-fit")
    pose_is_set_by_dragging(page, told)


def costs_are_shown_on_request(page: Page, obstacle: tuple[int, int]) -> None:
    saved_map(page, obstacle, (255, 255, 255))
    for colour in ((106, 27, 154), (255, 255, 255)):
        press_until(page, "#map-layers", ".q-menu")
        page.click(".q-menu .q-checkbox:has-text('Costmap: obstacles')")
        page.click("#map-text")
        page.wait_for_selector(".q-menu", state="detached")
        saved_map(page, obstacle, colour)


def refusal_and_cancel_of_a_goal_are_shown(page: Page, told: Told) -> None:
    page.click("#map-mode >> text=Set goal")
    page.wait_for_selector("#map-view[data-placing=goal]")
    page.click("#map-view")
    page.wait_for_selector(".q-notification:has-text('the goal was refused: one goal is enough')")
    page.click("#map-cancel")
    told.waits_for("cancel")
    page.wait_for_selector(".q-notification:has-text('the goal was cancelled: an operator cancelled it')")
    page.wait_for_selector(".q-notification:has-text('the robot has no goal')")


def saved_map(page: Page, place: tuple[int, int], colour: tuple[int, int, int]) -> Image.Image:
    """Save the map until a pixel, counted from its middle, has this colour; return the picture."""
    pictures: list[Image.Image] = []

    def has_colour() -> bool:
        with page.expect_download() as download:
            page.click("#map-save")
        picture = Image.open(download.value.path()).convert("RGB")
        pictures[:] = [picture]
        return picture.getpixel((picture.width // 2 + place[0], picture.height // 2 + place[1])) == colour

    wait_until(has_colour)
    return pictures[0]


def pose_is_set_by_dragging(page: Page, told: Told) -> None:
    page.click("#map-mode >> text=Set pose")
    page.wait_for_selector("#map-view[data-placing=initial_pose]")
    box = page.locator("#map-view").bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 60)
    page.mouse.up()
    frame, *place = told.waits_for("pose")
    assert frame == "map"
    assert [float(word) for word in place] == pytest.approx([2.0, 3.75, np.pi / 2], abs=0.05)

    no_go_area_and_place_are_drawn(page, told)
    goals_are_added_and_a_distance_is_measured(page, told)


def no_go_area_and_place_are_drawn(page: Page, told: Told) -> None:
    begin_drawing(page, "no_go")
    box = page.locator("#map-view").bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for corner in ((x, y), (x + 60, y), (x + 60, y - 60), (x + 2, y)):  # the first one again closes the area
        page.mouse.click(*corner)
    page.fill("#map-card-name", "stairs")
    page.click("#map-card-save")
    *_, right, top = map(float, told.waits_for("area", "stairs"))
    assert right > 2.0
    assert top > 3.75
    page.wait_for_selector("#map-text:has-text('1 no-go areas')")
    begin_drawing(page, "place")
    page.mouse.click(x, y)
    page.fill("#map-card-name", "kitchen")
    page.keyboard.press("Enter", delay=HELD_MS)
    page.wait_for_selector("#map-text:has-text('home; kitchen')")
    page.click("#map-draw")
    page.click("#map-drawings >> text=Go to kitchen")
    told.waits_for("place", "kitchen")
    page.wait_for_selector(".q-notification:has-text('the goal was refused: it is only a test')")


def goals_are_added_and_a_distance_is_measured(page: Page, told: Told) -> None:
    page.click("#map-mode >> text=Add goal")
    page.wait_for_selector("#map-view[data-placing=next_goal]")
    box = page.locator("#map-view").bounding_box()
    assert box
    middle_x, middle_y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.click(middle_x + 60, middle_y)
    x_m = float(told.waits_for("goal", "map")[0])
    goals = told.count("goal")
    page.mouse.click(middle_x - 60, middle_y)  # it waits for the first one, which is then cancelled
    page.wait_for_function(f"{WAITING}.length === 1")
    page.click("#map-undo")
    page.wait_for_function(f"{WAITING}.length === 0")
    page.click("#map-measure")
    page.wait_for_function("Object.values(mounted_app.$refs).flat().find((one) => one?.measure).measures")
    page.mouse.move(middle_x, middle_y)
    page.mouse.down()
    page.mouse.move(middle_x + 60, middle_y)
    page.mouse.up()
    page.wait_for_selector(f"#map-view[data-measured='{x_m - 2.0:.2f}']")
    page.click("#map-cancel")
    told.waits_for("cancel")
    assert told.count("goal") == goals, "a goal that waits for another was sent at once"


def joint_moves_while_its_pose_is_held(page: Page) -> None:
    open_panel(page, "joints")
    page.wait_for_selector("[data-at='arm/wrist']:has-text('0.000 rad')")
    press_until(page, "[data-pose=wave]", "[data-at='arm/wrist']:has-text('0.500 rad')", hold)
    page.mouse.up()
    assert float(page.input_value("[data-joint='arm/wrist']")) == pytest.approx(0.5, abs=0.01)


def hold(page: Page, button: str) -> None:
    """Hold a button. The robot takes it as let go while the connection is slow; then it is held again."""
    page.mouse.up()
    page.hover(button)
    page.mouse.down()


def walls_are_raised_and_goal_is_set_on_the_floor(page: Page, told: Told) -> None:
    open_panel(page, "view")
    page.wait_for_selector("#view-moving[data-walls='1']")  # the wall at the left, in all rows that are known
    scene_without_a_graphics_card_is_coarse(page)
    page.click("#view-goal")
    page.wait_for_selector("#view-moving[data-placing=goal]")
    page.evaluate(MOVE_CAMERA_AND_CLICK)
    frame, *place = told.waits_for("goal")
    assert frame == "map"
    assert [float(word) for word in place[:2]] == pytest.approx([0.0, 0.0], abs=0.05)
    open_panel(page, "map")
    page.click("#map-cancel")
    told.waits_for("cancel")


def scene_without_a_graphics_card_is_coarse(page: Page) -> None:
    """It has rough edges from the beginning; if that is not enough, fewer pixels and only near walls."""
    scene = "document.querySelector('#view-scene canvas')"
    smooth = f"{scene}.getContext('webgl2').getContextAttributes().antialias"
    assert page.evaluate(smooth) is False
    assert page.evaluate(
        "document.createElement('canvas').getContext('webgl2').getContextAttributes().antialias"
    )
    raised = page.evaluate(NEAR_AND_FAR_WALLS)
    assert raised == {"fine": [True, True], "coarse": [True, False], "ratio": 0.5}


def cameras_are_shown(page: Page) -> None:
    open_panel(page, "cameras")
    page.wait_for_selector("#panel-cameras :text('2 x 1 bgr8')")
    page.wait_for_function("document.querySelector('#panel-cameras img').naturalWidth == 2")
    page.wait_for_selector(".detection-boxes > div:has-text('fox 70%')")
    page.wait_for_function(FOX_IS_IN_ITS_PLACE)
    page.wait_for_selector("#panel-cameras .no-picture:has-text('mystery')")
    page.wait_for_selector("#panel-cameras :text('4 x 2 16UC1 (depth: near is bright)')")
    page.wait_for_function(f"({DEPTHS})()?.join() === '255,40,0'")
    panel, picture = (
        page.locator(one).bounding_box() for one in ("#panel-cameras", "#panel-cameras img >> nth=0")
    )
    assert panel
    assert picture
    assert picture["width"] > 0.3 * panel["width"], "a third of the tile for each of three cameras"
    assert page.evaluate(SCROLLS, "#panel-cameras") is False


def image_of_a_silent_camera_shows_its_age(page: Page, robot: Robot) -> None:
    open_panel(page, "cameras")
    page.wait_for_selector("#panel-cameras :text('2 x 1 bgr8')")
    page.wait_for_selector("#panel-cameras :text('silent')", state="hidden")
    robot.command("module", "stop", "known", "--run", robot.known_run().run_id)
    page.wait_for_selector("#panel-cameras .picture-age.is-silent:text-matches('[0-9.]+ s old')")
    page.wait_for_selector("#panel-cameras .newest-image.grayscale")


def commands_of_the_profile_are_given(page: Page, told: Told) -> None:
    open_panel(page, "speech")
    page.click("#speech-commands >> text=come here")
    assert told.waits_for("said") == ["come", "here"]
    page.wait_for_selector("#speech-heard:has-text('operator: come here')")
    assert "Anna" in page.inner_text("#speech-persons")
    assert "cup" in page.inner_text("#speech-objects")


def trace_is_filtered_and_what_is_recorded_is_chosen(page: Page, robot: Robot) -> None:
    open_panel(page, "trace")
    page.wait_for_selector("#trace-log :text('the curtain rises')")
    page.wait_for_selector("#trace-log :text('operator station: http')")
    page.fill("#trace-text", "CURTAIN")
    page.wait_for_selector("#trace-log :text('operator station: http')", state="detached")
    (line,) = page.inner_text("#trace-log").split("\n")
    assert line.endswith("known#1 warning the curtain rises")
    page.fill("#trace-text", "")
    run_folder = next(run.folder for run in live_runs())
    assert read_recorded(run_folder)["known"] == ["error", "warning", "info"]
    page.click("#trace-recorded")
    page.click(".q-menu .q-item:has-text('system')")
    page.wait_for_selector(".q-notification:has-text('every module: error, warning, info, system')")
    assert read_recorded(run_folder)["known"] == [*Kind]
    open_panel(page, "trace")  # which closes the menu


def messages_are_shown_and_composed(page: Page, told: Told) -> None:
    open_panel(page, "messages")
    page.click("#messages-topics tr:has-text('geometry_msgs/msg/PoseStamped'):has-text('map_pose')")
    page.wait_for_selector("#messages-chosen:has-text('topic map_pose, from known')")
    topics_and_message_share_the_tile(page)
    page.click("#messages-tree :text-is('pose')")
    page.click("#messages-tree :text-is('position')")
    page.wait_for_selector("#messages-tree :text-is('y: 3.25')")

    page.click("#messages-compose >> text=Compose a message")
    page.fill("#compose-type", "zoo/msg/Wish")
    page.click(".q-menu .q-item:has-text('zoo/msg/Wish')")
    page.fill("[data-field='weight_kg']", "heavy")
    page.fill("[data-field='text']", "peace: now")
    page.fill("[data-field='place.x']", "2.5")
    page.fill("#compose-topic", "wishes")
    page.click("#compose-send")
    page.wait_for_selector("#compose-fields [role=alert]:has-text('weight_kg')")
    assert page.locator("#compose-fields [role=alert]").count() == 1
    page.fill("[data-field='weight_kg']", "70")
    page.click("#compose-send")
    assert told.waits_for("wish") == ["peace:", "now", "2.5", "70.0"]
    page.wait_for_selector("#compose-result:has-text('sent a zoo/msg/Wish')")


def topics_and_message_share_the_tile(page: Page) -> None:
    """They are beside each other in a wide tile, and use all of its height."""
    parts = ("#panel-messages", "#messages-topics", ".messages-message")
    panel, topics, message = (page.locator(one).bounding_box() for one in parts)
    assert panel
    assert topics
    assert message
    assert message["x"] >= topics["x"] + topics["width"]
    for part in (topics, message):
        assert 0.9 * panel["height"] < part["height"] <= panel["height"]
    assert page.evaluate(SCROLLS, "#panel-messages") is False


def crash_is_reported(page: Page) -> None:
    page.fill("[data-field='text']", "break")
    page.click("#compose-send")
    open_panel(page, "trace")
    page.click("#trace-crashes >> text=crash of fragile, start 1")
    page.wait_for_selector("#trace-crashes :text('RuntimeError: it is broken')")
    open_panel(page, "messages")


def messages_are_sent_at_a_rate_until_the_page_goes(page: Page, told: Told, robot: Robot) -> int:
    """Return how many there were in the end."""
    page.fill("[data-field='text']", "again")
    page.fill("#compose-rate", "1000")
    page.click("#compose-begin")
    page.wait_for_selector(".q-field:has(#compose-rate) [role=alert]:has-text('at most 20')")
    assert told.count("wish again") == 0
    page.fill("#compose-rate", "5")
    page.click("#compose-begin")
    wait_until(lambda: told.count("wish again") > 3)
    page.click("#compose-end")
    page.wait_for_selector("#compose-begin:visible")
    before = told.count("wish")
    page.click("#compose-begin")
    wait_until(lambda: told.count("wish") > before)
    page.reload()
    wait_until(lambda: "no more zoo/msg/Wish are sent: the page was closed" in robot.log("operator"))
    page.click("#mark")
    told.waits_for("mark", "mark", "3")  # which comes after all of them
    return told.count("wish")
