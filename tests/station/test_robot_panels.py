"""3-D view, plots, parameters and process table show the true state, and their buttons work."""

import io
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from tests._support.robot import LIMIT_S, Robot, wait_until
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of, titles_of
from tools.pictures.operator import choose

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(600)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, robot_model: robot.stl, panels: ["zoo.own_panel:FriendsPanel"]}
  stage: {class: "zoo.stage:Stage"}
  lamps:
    class: robbie_robots.modules.devices.lights:SimulatedLightsModule
    settings: {lights: [headlight, rear light]}
"""
COUNT_CONTEXTS = """() => {
window.contexts = window.lost = 0;
const before = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  if (/webgl/.test(kind) && !this.is_counted) {
    this.is_counted = true;
    window.contexts += 1;
    if (this.isConnected) this.addEventListener("webglcontextlost", () => (window.lost += 1));
  }
  return before.call(this, kind, ...more);
};
}"""
MAX_CONTEXTS = 3
"""One draws the scene, and one finds out whether there is a graphics card. A browser keeps 16."""
LONG_MS = 1000
"""The page shows what the robot says several times meanwhile."""
NODES = {"base_link": "1.50,-0.50,0.00", "laser": "1.70,-0.50,0.10", "red/base_link": "3.00,1.25,0.00"}
SCENE = "Object.entries(window).find(([name]) => name.startsWith('scene_'))[1]"
REFERENCES = "Object.values(mounted_app.$refs).flat()"
SCENE_COMPONENT = f"{REFERENCES}.find((one) => one?.$el?.id === 'view-scene')"
CAMERA = f"{SCENE_COMPONENT}.camera.position.x"
VIEW = f"{REFERENCES}.find((one) => one?.effort)"
# As without a graphics card, where a picture takes long: what was told to be computed never becomes complete.
NEVER_COMPLETE = f"""() => {{
  const gl = {VIEW}.renderer.getContext();
  gl.getSyncParameter = () => gl.UNSIGNALED;
}}"""
BY_ITSELF = f"() => delete {VIEW}.renderer.getContext().getSyncParameter"
SKY = f"{VIEW}.renderer.getClearColor({VIEW}.floor.material.color.clone()).getHexString()"
MODEL = f"""() => {{
  let is_there = false;
  const look = (one) => (is_there ||= one.geometry?.attributes.position?.count === 3);
  {SCENE}.getObjectByName("base_link").traverse(look);
  return is_there;
}}"""
ICON_WIDTH = """(() => {
  const range = document.createRange();
  range.selectNodeContents(document.querySelector("#tab-friends .q-icon"));
  return range.getBoundingClientRect().width;
})()"""
TRIANGLE = """solid robot
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 0.4 0 0
vertex 0 0.3 0
endloop
endfacet
endsolid robot
"""
POSITION = f"""() => {{
  const found = {SCENE}.getObjectByName("NAME");
  if (!found) return "";
  return found.getWorldPosition(found.position.clone()).toArray().map((x) => x.toFixed(2)).join();
}}"""


def set_to(page: Page, value: str, error: str) -> None:
    """Ask for a value, and see the error that stands beside the field then."""
    page.fill("#input-stage-x_m", value)
    page.click("#set-stage-x_m")
    if error:
        page.wait_for_selector(f".q-field:has(#input-stage-x_m) [role=alert]:has-text('{error}')")
    else:
        page.wait_for_selector(".q-field:has(#input-stage-x_m) [role=alert]", state="detached")


def remove_line(page: Page) -> None:
    """Remove the plot's first line; a second click before it is gone would hit the same line."""
    buttons = page.locator("#plot-lines [aria-label=remove]")
    count = buttons.count()
    buttons.first.click()
    expect(buttons).to_have_count(count - 1, timeout=1000 * LIMIT_S)


def plot(page: Page, messages: str, path: str) -> None:
    """Choose a number."""
    page.fill("#plot-channel", messages)
    page.fill("#plot-field", path)
    page.click("#plot-add")


def robots_own_panel_has_a_tab_and_is_in_sight_on_every_tab(page: Page) -> None:
    page.wait_for_selector("#friends-greeting:text-is('hello')")
    titles = titles_of(page)
    assert titles[titles.index("Cameras") + 1] == "Friends"
    page.click("#tab-friends")
    page.wait_for_selector("#friends-text:text-is('Anna is here')")
    assert page.is_visible("#friends-greeting")
    # A panel from elsewhere may have any icon and any style of NiceGUI, which come after the first picture.
    page.wait_for_function(ICON_WIDTH + " < 30")  # and not as wide as the word
    page.wait_for_function("getComputedStyle(document.querySelector('#friends-text')).fontStyle === 'italic'")


def view_shows_what_there_is(page: Page) -> None:
    page.click("#tab-view")
    # Two of the scan's rays hit something; the cloud has five points.
    robots = "robot at 1.50 m, -0.50 m, 0°; red at 3.00 m, 1.25 m"
    others = "7 points, 1 friends, 1 points of interest"
    page.wait_for_selector(f"#view-figures:text-is('{robots}; {others}')")
    for name, place in NODES.items():
        page.wait_for_function(f"({POSITION.replace('NAME', name)})() === '{place}'")
    for text in ("red", "door", "Anna"):
        page.wait_for_selector(f"#view-scene >> text={text}")
    page.wait_for_function(MODEL)
    assert not page.locator("#view-scene >> text=laser").is_visible()
    page.click("#view-layers")
    page.click("#view-names")
    page.wait_for_selector("#view-scene >> text=laser")
    page.click("#tab-map")
    page.wait_for_selector("#map-text:has-text('red at 3.00 m, 1.25 m; 1 friends; door')")


def view_fills_its_tile_and_is_drawn_after_many_layouts(page: Page) -> None:
    """It must neither be higher than its tile, nor have no height, nor lose what it draws with."""
    for turn in range(10):
        choose(page, ("Drive", "Playback", "Engineer")[turn % 3])
    page.click("#maximise-map")
    choose(page, "Drive")  # which is the same layout with one tile enlarged
    assert not page.locator(".has-alone").count()
    tile, scene = (page.locator(one).bounding_box() for one in ("#tile-view", "#view-scene canvas"))
    assert tile and scene
    assert scene["height"] > 0.5 * tile["height"]
    figures = page.locator("#view-figures").bounding_box()
    assert figures
    assert figures["y"] + figures["height"] <= tile["y"] + tile["height"]
    wait_until(lambda: colours_of(page, "#view-scene canvas") > 3)
    assert page.evaluate("window.contexts") <= MAX_CONTEXTS
    assert page.evaluate("window.lost") == 0


def colours_of(page: Page, what: str) -> int:
    """Count the colours of a part of the page, as it is seen."""
    seen = Image.open(io.BytesIO(page.locator(what).screenshot())).convert("RGB")
    return len(seen.getcolors(seen.width * seen.height) or [])


def view_has_no_picture_in_work_while_it_is_hidden(page: Page) -> None:
    """Otherwise the time out of sight counts as that picture's, and the view rests when it is shown again."""
    page.click("#tab-view")
    page.wait_for_function(VIEW)
    page.evaluate(NEVER_COMPLETE)
    page.wait_for_function(f"{VIEW}.effort.fence !== null")
    page.click("#tab-map")
    page.wait_for_function(f"!{VIEW}.live.in_sight")
    page.wait_for_function(f"{VIEW}.effort.fence === null")
    page.wait_for_function(f"{SCENE_COMPONENT}.fps === 4")
    page.evaluate(BY_ITSELF)


def view_takes_the_colours_of_the_look(page: Page) -> None:
    page.click("#tab-view")
    page.wait_for_function(f"{SCENE_COMPONENT}.fps === 60")
    page.wait_for_function(f"{SKY} === '1d232a'")
    page.click("#look")
    page.wait_for_function(f"{SKY} === 'b8c5d0'")
    name = page.locator("#view-scene >> text=door")
    dark_on_bright = "(one) => [getComputedStyle(one).color, getComputedStyle(one).backgroundColor]"
    assert name.evaluate(dark_on_bright) == ["rgb(23, 32, 42)", "rgb(255, 255, 255)"]
    page.click("#look")
    page.wait_for_function(f"{SKY} === '1d232a'")


def parameters_are_changed_and_wrong_ones_refused(page: Page, robot: Robot) -> None:
    page.click("#tab-parameters")
    page.wait_for_selector("#value-stage-x_m:text-is('x_m: 1.5')")
    set_to(page, "9.0", "at most 5")
    set_to(page, "'no number'", "number")
    set_to(page, "3.0", "there is a hole at 3 m")
    assert robot.top()["stage"]["status"] == "stands at 1.5 m; red; 0.75  False 3"
    set_to(page, "2.5", "")
    page.wait_for_selector("#value-stage-x_m:text-is('x_m: 2.5 (changed)')")
    robot.until(lambda modules: modules["stage"]["status"] == "stands at 2.5 m; red; 0.75  False 3")
    page.click("#tab-view")
    page.wait_for_selector("#view-figures:has-text('robot at 2.50 m')")


def camera_follows_the_robot_or_is_free(page: Page, robot: Robot) -> None:
    camera = f"{CAMERA}.toFixed(2)"
    page.wait_for_function(f"{camera} === '-0.50'")  # 3 m behind the robot
    page.click("#view-follow")
    page.click("#tab-parameters")
    set_to(page, "2.0", "")
    page.click("#tab-view")
    page.wait_for_selector("#view-figures:has-text('robot at 2.00 m')")
    page.wait_for_function(f"({POSITION.replace('NAME', 'base_link')})() === '2.00,-0.50,0.00'")
    assert page.evaluate(camera) == "-0.50"
    page.click("#tab-parameters")
    set_to(page, "2.5", "")


def virtual_devices_obey(page: Page, robot: Robot) -> None:
    page.click("#tab-devices")
    page.wait_for_selector("#device-stage:has-text('0.75  False 3')")
    move_slider(page, "virtual_charge", 0.2)
    move_slider(page, "virtual_level", 0.7)
    robot.until(lambda modules: modules["stage"]["status"].endswith("; 0.2  False 7"))
    page.click("#control-stage-virtual_pressed")
    page.click(".q-menu .q-item:has-text('right')")
    page.click("#tab-devices")  # which closes the menu
    page.click("#control-stage-virtual_fails")
    page.wait_for_selector("#device-stage:has-text('0.2 right True')")
    page.wait_for_selector("#value-stage-virtual_pressed:text-is('set to [right]')")
    robot.until(lambda modules: "0.2 right True" in modules["stage"]["status"])


def move_slider(page: Page, setting: str, part: float) -> None:
    slider = page.locator(f"#control-stage-{setting}")
    box = slider.bounding_box()
    assert box
    slider.click(position={"x": box["width"] * part, "y": box["height"] / 2})


def lights_are_switched_by_key_button_and_slider(page: Page, robot: Robot) -> None:
    page.click("#tab-joints")
    page.wait_for_selector("[data-light-at='rear light']:text-is('0%')")
    page.focus("[data-light='rear light'] [tabindex]")
    page.keyboard.press("ArrowRight", delay=LONG_MS)
    robot.until(lambda modules: modules["lamps"]["status"] == "headlight 0%, rear light 5%")
    page.wait_for_selector("[data-light-at='rear light']:text-is('5%')")
    page.click("#tab-camera")
    page.wait_for_selector("#lights[aria-pressed=true]")
    page.click("#lights")
    robot.until(lambda modules: modules["lamps"]["status"] == "headlight 0%, rear light 0%")
    page.wait_for_selector("#lights[aria-pressed=false]")
    page.keyboard.press("f")
    robot.until(lambda modules: modules["lamps"]["status"] == "headlight 100%, rear light 100%")


def plots_draw_chosen_numbers(page: Page) -> None:
    page.click("#tab-plots")
    # Until an operator has chosen something: speed and turn rate.
    page.wait_for_selector("#plot-lines:has-text('odom.twist.twist.angular.z: 0')")
    remove_line(page)
    remove_line(page)
    page.wait_for_selector("#plot-lines:has-text('odom')", state="detached")
    plot(page, "odom: nav_msgs/Odometry", "pose.pose.position.x")
    page.wait_for_selector("#plot-lines:has-text('odom.pose.pose.position.x: 2.5')")
    plot(page, "(no topic): sensor_msgs/LaserScan", "ranges[3]")
    page.wait_for_selector("#plot-lines:has-text('LaserScan.ranges[3]: 3')")
    page.wait_for_selector("#panel-plots svg text:has-text('LaserScan.ranges[3]')")
    plot(page, "(no topic): sensor_msgs/LaserScan", "rangers[3]")
    page.wait_for_selector("#panel-plots [role=alert]:has-text(\"did you mean 'ranges'\")")
    remove_line(page)
    page.wait_for_selector("#plot-lines:has-text('odom')", state="detached")
    page.wait_for_selector("#panel-plots svg text:text-is('3')")


def system_shows_processes_and_restarts_and_stops_them(page: Page, robot: Robot) -> None:
    page.click("#tab-system")
    page.wait_for_selector("#panel-system td:has-text('stands at 2.5 m; red')")
    page.wait_for_selector("#panel-system .nicegui-echart text:text-is('cpu 0')")
    page.click("#panel-system th:has-text('pid')")
    pids = sorted(figures["pid"] for figures in robot.top().values())
    in_order = ".*".join(rf"\b{pid}\b" for pid in pids)
    page.wait_for_function(
        "order => RegExp(order, 's').test(document.querySelector('#panel-system tbody').innerText)",
        arg=in_order,
    )
    pid = robot.top()["stage"]["pid"]
    page.click("#panel-system tr:has(td:text-is('stage')) .q-checkbox")
    page.click("#order-restart")
    page.click("text='No'")
    page.click("#order-restart")
    page.click("#confirm-order")
    page.wait_for_selector(".q-notification:has-text('stage')")
    robot.until(lambda modules: modules["stage"]["pid"] != pid)
    page.click("#order-stop")
    page.click("#confirm-order")
    page.wait_for_selector("#panel-system tr:has(td:text-is('stage')) td:text-is('STOPPED')")


def test_panels_show_and_change_the_robot(robot: Robot) -> None:
    (robot.folder / "zoo" / "stage.py").write_text((HERE / "_support" / "stage.py").read_text())
    (robot.folder / "zoo" / "own_panel.py").write_text((HERE / "_support" / "own_panel.py").read_text())
    (robot.folder / "robot.stl").write_text(TRIANGLE)
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address) as page:
        page.evaluate(COUNT_CONTEXTS)
        robots_own_panel_has_a_tab_and_is_in_sight_on_every_tab(page)
        view_shows_what_there_is(page)
        view_has_no_picture_in_work_while_it_is_hidden(page)
        view_fills_its_tile_and_is_drawn_after_many_layouts(page)
        view_takes_the_colours_of_the_look(page)
        parameters_are_changed_and_wrong_ones_refused(page, robot)
        camera_follows_the_robot_or_is_free(page, robot)
        plots_draw_chosen_numbers(page)
        lights_are_switched_by_key_button_and_slider(page, robot)
        virtual_devices_obey(page, robot)
        page.click("#tab-drive")
        page.wait_for_selector("#velocity:text-is('0.00 m/s, 0.00 rad/s')")
        system_shows_processes_and_restarts_and_stops_them(page, robot)
        page.click("#tab-drive")
        page.wait_for_selector("#velocity:has-text('ago; the odometry is silent')")
