"""The program `robbie top`, its views and its keys, on a simulated terminal."""

import asyncio
import html
import re
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets._footer import FooterKey

from robbie_mp.cli.top_program import program as program_module
from robbie_mp.cli.top_program.feed import Watching
from robbie_mp.cli.top_program.program import TopProgram
from robbie_mp.run.control import ControlRefused
from tests.cli._support.readings import BACKOFF, SECOND_NS, PlayedFeed, laser, mapping, run
from tests.cli.test_module_log import TRACEBACK, entry, write

CELL_WIDTH = 12.2
"""Width of a character in the picture of the terminal."""
FOREGROUND_OF_PICTURES = "c5c8c6"
Script = Callable[[Pilot[None]], Awaitable[None]]


def play(feed: PlayedFeed, script: Script, size: tuple[int, int] = (80, 24)) -> None:
    """Run the program, which looks only when the script says so, and do what the script does."""

    async def run_it() -> None:
        app = TopProgram(feed, 3600.0)  # type: ignore[arg-type]
        async with app.run_test(size=size, notifications=True) as pilot:
            # The footer gets its keys, and they their places, later than the rest is drawn.
            while not (keys := app.screen.query(FooterKey)) or not all(key.size.width for key in keys):
                await pilot.pause()
            await script(pilot)

    asyncio.run(run_it())


def shown(pilot: Pilot[None]) -> str:
    """What is on the terminal, as text."""
    svg = pilot.app.export_screenshot()
    lines: dict[float, str] = {}
    for found in re.findall(r'<text [^>]*x="([\d.]+)" y="([\d.]+)"[^>]*>(.*?)</text>', svg):
        x, y = float(found[0]), float(found[1])
        text = html.unescape(found[2]).replace("\xa0", " ")
        lines[y] = lines.get(y, "").ljust(round(x / CELL_WIDTH)) + text  # blanks are left out there
    return "\n".join(lines[y] for y in sorted(lines))


async def until_shown(pilot: Pilot[None], pattern: str) -> None:
    """Wait until the terminal shows this: on a busy machine, a new screen gets its places after the keys."""
    while not re.search(pattern, shown(pilot)):
        await pilot.pause()


def line_of(pilot: Pilot[None], start: str) -> str:
    return next(line for line in shown(pilot).splitlines() if line.strip().startswith(start))


def order(pilot: Pilot[None], *names: str) -> list[str]:
    text = shown(pilot)
    return sorted(names, key=lambda name: text.index(f" {name} "))


async def look(pilot: Pilot[None]) -> None:
    assert isinstance(pilot.app, TopProgram)
    pilot.app.look()
    await pilot.pause()


def test_terminal_of_80_columns_shows_the_modules_and_all_keys() -> None:
    async def script(pilot: Pilot[None]) -> None:
        text = shown(pilot)
        assert "0a1b2c3d demo" in text
        assert "routed 100/s" in text
        row = line_of(pilot, "mapping").split()
        # name, state, restarts, cpu %, in/s, what did not fit into the queue, status
        assert row[:9] == ["mapping", "RUNNING", "0", "50.0", "30.0", "3", "[EXPLORE]", "draws", "[a]"]
        footer = shown(pilot).splitlines()[-1]
        for key in ("More", "Modules", "Types", "Graph", "Sort", "Filter", "Hold", "Restart", "Stop", "Quit"):
            assert key in footer

    play(PlayedFeed(), script)


def test_each_view_has_its_key() -> None:
    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("2")
        scan = line_of(pilot, "sensor_msgs/LaserScan front")
        assert scan.split()[2:6] == ["40.0", "3.9K", "5.0ms", "250ms"]
        assert "laser" in scan
        assert "mapping" in scan
        await pilot.press("3")
        assert "└─ sensor_msgs/LaserScan front 40.0/s ─▶ mapping 3 dropped" in shown(pilot)
        await pilot.press("1")
        assert line_of(pilot, "laser")

    play(PlayedFeed(), script, size=(130, 24))


def test_rows_are_sorted_by_the_chosen_column() -> None:
    async def script(pilot: Pilot[None]) -> None:
        assert order(pilot, "laser", "mapping", "core") == ["laser", "mapping", "core"]
        await pilot.press("s")
        assert order(pilot, "laser", "mapping", "core") == ["core", "laser", "mapping"]
        await pilot.press("s", "s", "s")
        assert "sorted by cpu%" in shown(pilot)
        assert order(pilot, "laser", "mapping", "core") == ["mapping", "laser", "core"]
        await pilot.press("S")
        assert order(pilot, "laser", "mapping", "core") == ["core", "laser", "mapping"]

    play(PlayedFeed(), script)


def test_cursor_stays_on_its_module_while_rows_move() -> None:
    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("down", "down")
        assert isinstance(pilot.app, TopProgram)
        assert pilot.app.selected_module() == "mapping"
        await pilot.press("s", "s", "s", "s")
        await look(pilot)
        assert pilot.app.selected_module() == "mapping"
        assert "mapping: [EXPLORE]  draws [a] map" in shown(pilot)

    play(PlayedFeed(), script)


def test_filter_shows_only_rows_that_contain_it() -> None:
    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("slash", *"MAP")
        assert "laser" not in shown(pilot)
        assert line_of(pilot, "mapping")
        await pilot.press("enter")
        assert "only 'MAP'" in shown(pilot)
        await pilot.press("escape")
        assert line_of(pilot, "laser")

    play(PlayedFeed(), script)


def test_frozen_figures_do_not_change() -> None:
    feed = PlayedFeed()

    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("space")
        assert "FROZEN" in shown(pilot)
        feed.modules = lambda at_s: (laser(at_s),)
        await look(pilot)
        assert line_of(pilot, "mapping")
        await pilot.press("space")
        assert "mapping" not in shown(pilot)

    play(feed, script)


@pytest.mark.slow
def test_details_show_times_counters_log_and_the_last_crash(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    crash = entry(1, "ZeroDivisionError", "log", level="CRITICAL", traceback=TRACEBACK)
    write(tmp_path, crash, entry(2, "laser works again"))
    feed = PlayedFeed(tmp_path)
    feed.modules = lambda at_s: (laser(at_s, last_end="exit code 1", restarts=1), mapping(at_s))

    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("down", "enter")
        await until_shown(pilot, "works again")
        text = shown(pilot)
        for part in ("last end: exit code 1", "handler", "publishes sensor_msgs", "works again", "█"):
            assert part in text
        assert "ZeroDivisionError: division by zero" in text
        await pilot.press("escape", "down", "enter")
        await until_shown(pilot, r"sensor_msgs/msg/LaserScan front +40 +30 +0 +3 +2 +0 +5 +all")
        await pilot.press("2")  # of the views, which are not seen
        assert "subscribes to" in shown(pilot)
        await pilot.press("escape")
        assert line_of(pilot, "laser")

    play(feed, script, size=(120, 50))


@pytest.mark.slow
def test_program_that_ends_while_details_are_shown_is_quiet() -> None:
    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("enter")
        await pilot.app.screen.query("#details").remove()  # as at the end, while the timer still runs
        await look(pilot)

    play(PlayedFeed(), script)


@pytest.mark.parametrize(("key", "command"), [("r", "restart"), ("x", "stop")])
def test_module_is_restarted_or_stopped_only_after_a_confirmation(
    key: str, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[tuple[str, str]] = []

    def control(_folder: Path, what: str, name: str) -> str:
        said.append((what, name))
        return f"{name} is RUNNING, start 2"

    monkeypatch.setattr(program_module, "control", control)

    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("down", key)
        assert f"{command} laser of run 0a1b2c3d?" in shown(pilot)
        await pilot.press("n")
        assert not said
        await pilot.press(key, "y")
        await pilot.app.workers.wait_for_complete()
        await pilot.pause()
        assert said == [(command, "laser")]
        await until_shown(pilot, "laser is RUNNING, start 2")

    play(PlayedFeed(), script)


def test_refusal_of_the_supervisor_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    def control(_folder: Path, _what: str, _name: str) -> str:
        raise ControlRefused("laser is FAILED: exit code 1")

    monkeypatch.setattr(program_module, "control", control)

    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("down", "enter", "r", "y")
        await pilot.app.workers.wait_for_complete()
        await pilot.pause()
        assert "laser is FAILED" in shown(pilot)

    play(PlayedFeed(), script)


def test_supervisor_cannot_be_restarted() -> None:
    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("r")
        assert "supervisor cannot be told" in shown(pilot)
        assert "restart supervisor" not in shown(pilot)

    play(PlayedFeed(), script)


def test_hung_handler_is_named_for_any_cursor_position() -> None:
    feed = PlayedFeed()
    since = {"activity": "handler", "handler": "Mapping.on_scan", "busy_since_ns": 98 * SECOND_NS}
    feed.modules = lambda at_s: (laser(at_s), mapping(at_s, **since))

    async def script(pilot: Pilot[None]) -> None:
        assert "HUNG" in line_of(pilot, "mapping")
        assert "mapping: in Mapping.on_scan for 3.0 s" in shown(pilot)

    play(feed, script)


def test_module_that_waits_for_its_restart_shows_the_reason() -> None:
    feed = PlayedFeed()
    feed.modules = lambda at_s: (mapping(at_s, state=BACKOFF, pid=0, work=None, reason="killed by SIGSEGV"),)

    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("down")
        assert "BACKOFF" in line_of(pilot, "mapping")
        assert "mapping: killed by SIGSEGV" in shown(pilot)

    play(feed, script)


def test_silent_core_is_an_alarm() -> None:
    feed = PlayedFeed()
    feed.heartbeat_s = 98.0

    async def script(pilot: Pilot[None]) -> None:
        assert "CORE SILENT 3.0 s" in shown(pilot)
        feed.heartbeat_s = None
        await look(pilot)
        assert "CORE" not in shown(pilot)

    play(feed, script)


def test_top_waits_for_a_run_and_shows_its_end() -> None:
    feed = PlayedFeed()
    feed.watching = Watching.NOTHING
    feed.runs = ()

    async def script(pilot: Pilot[None]) -> None:
        assert "There is no such run" in shown(pilot)
        await pilot.press("1", "enter", "r", "s")  # nothing to do it with
        feed.watching, feed.runs = Watching.RUN, (run(),)
        await look(pilot)
        assert line_of(pilot, "laser")
        feed.watching = Watching.ENDED
        await look(pilot)
        assert "RUN HAS ENDED" in shown(pilot)

    play(feed, script)


def test_several_runs_are_listed_to_choose_from() -> None:
    feed = PlayedFeed()
    feed.watching = Watching.SEVERAL
    feed.runs = (run(), run("99999999"))

    async def script(pilot: Pilot[None]) -> None:
        assert "99999999" in shown(pilot)
        await pilot.press("n")
        assert feed.chosen == 1

    play(feed, script)


def test_no_color_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    feed = PlayedFeed()

    async def script(pilot: Pilot[None]) -> None:
        colours = set(re.findall(r"-r\d+ { fill: #(\w{6})", pilot.app.export_screenshot()))
        colours -= {FOREGROUND_OF_PICTURES}
        assert colours
        assert {colour for colour in colours if colour != 3 * colour[:2]} == set()

    play(feed, script)


def test_key_q_ends_the_program() -> None:
    async def script(pilot: Pilot[None]) -> None:
        await pilot.press("q")
        assert pilot.app.return_code == 0

    play(PlayedFeed(), script)
