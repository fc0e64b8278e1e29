"""Takes the pictures of the operator's page in docs/images: `python -m tools.pictures.operator [--layouts]`.

The tool runs the rescue robot, and crashes a module to have a crash report. It opens each panel in Chromium
and records a log meanwhile. Then it plays the log beside virtual devices, and runs a team of two robots for
the layout *Robots*. With `--layouts`, it takes only the pictures of the layouts, of each at three sizes. It
needs playwright and Chromium.
"""

import argparse
import io
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from robbie_mp.run.operator_link import read_link
from robbie_mp.run.run_directory import list_runs
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.generate_arena import generate_arena
from tools.operator.chromium import chromium
from tools.robot import COMMAND, REPOSITORY, Robot, free_port, stopping
from tools.trials.missions.rescue import WISHES
from tools.trials.missions.rescue_team import arguments_of, second_start

FOLDER = Path("docs/images")
SIZE: ViewportSize = {"width": 1280, "height": 800}
COLOURS = 256
SETTINGS = (
    "operator.port=0",
    "operator.speech_commands=[come back, stop, look around]",
    "operator.persons=[Anna, Ben]",
    "operator.objects=[red bag, helmet]",
    "victims.confirms_by_itself=false",
    "victims.answer_s=600",
)
CRASHES = "imu"
QUESTION = "#victim-question:visible"
VICTIMS_BEFORE = 2
"""Number of confirmed victims when the tool takes the picture of the map."""
LIMIT_S = 300.0
NAMES = ("Drive", "Mission", "Engineer", "Tablet", "Playback", "Robots")
"""The layouts in the order of their keys. A log plays in `PLAYBACK`; `ROBOTS` is of a team."""
*LIVE, PLAYBACK, ROBOTS = NAMES
TEAM_SEED = 1
TEAM_EXPLORES_S = 45.0
"""After this time, the map shows what both robots have seen."""
LARGE: ViewportSize = {"width": 1920, "height": 1080}
UPRIGHT: ViewportSize = {"width": 800, "height": 1280}
SIZES = (LARGE, UPRIGHT, SIZE)
SETTLED_S = 5.0
"""Time for which a panel is open before the tool takes its picture."""
LAYOUT_SETTLED_S = 5.0
KEY_LIMIT_MS = 5000
PLOTS = (
    ("odom: nav_msgs/Odometry", "twist.twist.linear.x"),
    ("odom: nav_msgs/Odometry", "twist.twist.angular.z"),
)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.pictures.operator")
    parser.add_argument("--layouts", action="store_true", help="take only the pictures of the layouts")
    only_layouts = parser.parse_args().layouts
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        settings = [word for setting in SETTINGS for word in ("--set", setting)]
        log = Path(folder, "log")
        with stopping(Robot(Path(folder, "rescue"), REPOSITORY, "rescue", *settings)) as robot:
            page = new_page(browser)
            page.goto(link(robot))
            with recording(robot, log):
                if only_layouts:
                    wait_for_victims(page, 1)
                    take_layouts(page, LIVE)
                    take_light(page)
                else:
                    take_panels(page, robot)
        words = (str(log), "virtual-playback", "--set", "operator.port=0", "--rate", "0.5")
        with stopping(Robot(Path(folder, "play"), REPOSITORY, *words, command=("play",))) as robot:
            page = new_page(browser)
            page.goto(link(robot))
            take_playback(page, only_layouts=only_layouts)
        take_team(new_page(browser), Path(folder, "team"))


def new_page(browser: Browser) -> Page:
    """Open a page that waits long enough for a robot that uses all processors."""
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(1000 * LIMIT_S)
    return page


@contextmanager
def recording(robot: Robot, folder: Path) -> Iterator[None]:
    """Record the running robot."""
    words = ["record", "--run", robot.run_id, "--output", str(folder)]
    process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.DEVNULL, env=robot.environment)
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def link(robot: Robot) -> str:
    """Return the link to the robot's page, when it is there."""
    robot.wait_for(robot.attach, "no run appeared")
    (run,) = list_runs(robot.bases)
    robot.wait_for(lambda: bool(read_link(run.folder)), "there is no page", LIMIT_S)
    return read_link(run.folder)


def take_panels(page: Page, robot: Robot) -> None:
    """Take a picture of each panel of the running robot."""
    turn_to(page, "plots")
    for channel, field in PLOTS:
        page.wait_for_selector(f"#plot-channel-offered option[value='{channel}']", state="attached")
        page.fill("#plot-channel", channel)
        page.fill("#plot-field", field)
        page.click("#plot-add")
    turn_to(page, "cameras")
    box, is_seen = page.locator(".detection-boxes > div"), False
    while not is_seen:  # it must also be there after the picture
        box.first.wait_for()
        take(page, "cameras", settled_s=0.0)
        is_seen = box.first.is_visible()
    turn_to(page, "map")
    wait_for_victims(page, VICTIMS_BEFORE)
    page.wait_for_selector(QUESTION)
    take(page, "map")
    answer(page)
    robot.send(robot.figures()[CRASHES].pid, signal.SIGSEGV)
    page.click("#mark")
    take_layouts(page, LIVE)
    take_light(page)
    turn_to(page, "speech")
    page.click("#speech-commands >> text=look around")
    for name in ("drive", "view", "mission", "speech", "system", "parameters", "devices", "plots"):
        turn_to(page, name)
        take(page, name)
    turn_to(page, "trace")
    page.click("#trace-crashes .q-item >> nth=0")
    take(page, "trace")
    take_time_line(page)
    turn_to(page, "messages")
    page.click("#messages-topics tr:has-text('sensor_msgs/msg/LaserScan')")
    take(page, "messages")


def take_time_line(page: Page) -> None:
    """Take a picture of the moment that was marked, beside the present."""
    turn_to(page, "timeline")
    page.click(".time-lane[data-lane=Marks] button >> nth=0")
    page.wait_for_function("document.querySelector('.moment .is-then img')?.naturalWidth > 0")
    take(page, "timeline")


def take_team(page: Page, folder: Path) -> None:
    """Take pictures of the layout with all robots of a team."""
    folder.mkdir()
    (folder / "arena.yaml").write_text(generate_arena(TEAM_SEED, WISHES))
    arena = read_arena(folder / "arena.yaml")
    starts, port = {"red": arena.start, "blue": second_start(arena)}, free_port()
    words = [arguments_of(name, starts, TEAM_SEED, folder, port) for name in starts]
    with (
        stopping(Robot(folder / "red", REPOSITORY, *words[0])) as red,
        stopping(Robot(folder / "blue", REPOSITORY, *words[1])),
    ):
        page.goto(link(red))
        page.wait_for_selector("#layouts")
        choose(page, ROBOTS)
        page.wait_for_selector(".robot-card[data-robot=blue] .robot-about:not(.is-stale)")
        page.wait_for_timeout(1000 * TEAM_EXPLORES_S)
        take_layouts(page, [ROBOTS])


def wait_for_victims(page: Page, count: int) -> None:
    """Confirm victims until a number of them is known."""
    for _ in range(count):
        page.wait_for_selector(QUESTION)
        answer(page)


def take_layouts(page: Page, layouts: Sequence[str]) -> None:
    """Take a picture of each layout at each size, as an operator's screen shows it."""
    for size in SIZES:
        page.set_viewport_size(size)
        for layout in layouts:
            choose(page, layout)
            wide = "" if size is SIZE else f"-{size['width']}"
            take(page, f"layout-{layout.lower()}{wide}", LAYOUT_SETTLED_S)
    page.set_viewport_size(SIZE)


def choose(page: Page, layout: str) -> None:
    """Show all tiles of a layout. A page that is being loaded again, on a busy machine, hears no key."""
    shown = page.locator(f".cockpit:has(#layouts:has-text('{layout}')):not(:has(.has-alone))")
    while not shown.is_visible():
        page.keyboard.press(f"{1 + NAMES.index(layout)}")
        with suppress(PlaywrightTimeout):
            shown.wait_for(timeout=KEY_LIMIT_MS)


def take_light(page: Page) -> None:
    """Take a picture of the first layout in the light look."""
    choose(page, NAMES[0])
    page.click("#look")
    take(page, "light", LAYOUT_SETTLED_S)
    page.click("#look")


def turn_to(page: Page, name: str) -> None:
    """Open a panel, and close questions that hide it."""
    if page.locator(QUESTION).is_visible():
        answer(page)
    page.click(f"#tab-{name}")
    page.wait_for_selector(f"#panel-{name}", state="visible")


def answer(page: Page) -> None:
    """Confirm the victim that the page asks about."""
    page.click("#victim-yes")
    page.wait_for_selector(QUESTION, state="hidden")


def take_playback(page: Page, *, only_layouts: bool) -> None:
    """Take pictures of the playback: the layout for it, and virtual devices."""
    page.wait_for_selector("#playback-events [data-at]")
    take_layouts(page, [PLAYBACK])
    if only_layouts:
        return
    page.click("#tab-devices")
    page.wait_for_selector("#playback-events [data-at]")
    page.wait_for_selector("#device-bumper")
    take(page, "playback")


def take(page: Page, name: str, settled_s: float = SETTLED_S) -> None:
    """Take a picture of the page, small enough for a repository."""
    page.wait_for_selector("#emergency-stop-state:has-text('ready')")  # on a busy machine, a link may be lost
    page.wait_for_timeout(1000 * settled_s)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    path = FOLDER / f"operator-{name}.png"
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(path, path.stat().st_size)


if __name__ == "__main__":
    main()
