"""An alarm is one sentence, and stays until it is over and somebody has seen it; each level has a sound."""

import pytest

from robbie_mp.run.supervisor.states import STATES, ChildState
from robbie_mp.station.page.alarms import MAX_ALARMS, AlarmCause, AlarmLevel, Alarms, causes_of
from robbie_mp.station.page.state_item import ALERT, GOOD, WARNING, StateItem
from tests._support.robot import Robot
from tests.cli._support.readings import laser, mapping
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of

PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  fragile: {class: "zoo.modules:CrashInSetup", optional: true, restart: {policy: never}}
"""
LOW = AlarmCause("battery", AlarmLevel.CAUTION, "The battery is low.")
EMPTY = AlarmCause("battery", AlarmLevel.DANGER, "The battery is empty.")
LINK = AlarmCause("link", AlarmLevel.NOTE, "The link is slow.")


def texts(alarms: Alarms) -> list[str]:
    return [one.cause.sentence for one in alarms.all]


def test_modules_and_items_of_the_strip_are_alarms_of_three_levels_with_their_names() -> None:
    failed = mapping(0.0, state=STATES.index(ChildState.FAILED) + 1)
    crashed = mapping(0.0, state=STATES.index(ChildState.BACKOFF) + 1)
    items = [
        StateItem("battery", "battery", "9%", ALERT, alarm="The battery is low: 9%."),
        StateItem("disk", "save", "9 GB", GOOD, alarm="The disk is full."),
        StateItem("machine", "memory", "cpu 99%", WARNING),
    ]
    found = [*causes_of([laser(0.0, health="it is unplugged"), failed], items), *causes_of([crashed], [])]
    assert [(one.level, one.sentence) for one in found] == [
        (AlarmLevel.CAUTION, "Module laser is DEGRADED: it is unplugged."),
        (AlarmLevel.DANGER, "Module mapping has FAILED and stays ended."),
        (AlarmLevel.DANGER, "The battery is low: 9%."),
        (AlarmLevel.NOTE, "Module mapping has crashed and is being restarted."),
    ]


def test_alarm_stays_until_it_is_over_and_acknowledged() -> None:
    alarms = Alarms()
    alarms.look([LOW])
    alarms.look([])
    (over,) = alarms.all
    assert not over.is_active
    alarms.acknowledge(over.number)
    assert not alarms.all
    alarms.look([LOW])
    alarms.acknowledge(alarms.all[0].number)
    assert texts(alarms) == ["The battery is low."]
    alarms.look([])
    assert not alarms.all


def test_alarm_that_becomes_worse_is_new_and_one_that_changes_its_figures_is_not() -> None:
    alarms = Alarms()
    alarms.look([LOW])
    alarms.acknowledge(alarms.all[0].number)
    alarms.look([AlarmCause("battery", AlarmLevel.CAUTION, "The battery is lower.")])
    assert (alarms.all[0].is_acknowledged, texts(alarms)) == (True, ["The battery is lower."])
    alarms.look([EMPTY])
    assert (alarms.all[0].is_acknowledged, texts(alarms)) == (False, ["The battery is empty."])


def test_most_urgent_alarm_is_the_first_and_their_number_is_bounded() -> None:
    alarms = Alarms()
    alarms.look([LINK, EMPTY])
    assert texts(alarms) == ["The battery is empty.", "The link is slow."]
    many = [AlarmCause(f"module {number}", AlarmLevel.NOTE, "It is ill.") for number in range(3 * MAX_ALARMS)]
    alarms.look([*many, EMPTY])
    assert (len(alarms.all), alarms.all[0].cause) == (MAX_ALARMS, EMPTY)


@needs_chromium
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_page_names_the_failed_module_in_line_tab_and_list_and_sounds_until_somebody_has_seen_it(
    robot: Robot,
) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.wait_for_selector("#alarm-line.is-level-3 #alarm-text:has-text('Module fragile has FAILED')")
        page.wait_for_selector("#alarms[data-sounded='3']")
        # On a busy machine other modules may be in cause, too.
        page.wait_for_function("/^[(][0-9][)] Module fragile has FAILED/.test(document.title)")
        before = page.locator("#alarm-line").bounding_box()
        page.click("#alarm-line")
        page.click("#alarm-list button[aria-label^='Acknowledge: Module fragile']")
        page.wait_for_selector("#alarm-list li:has-text('fragile') .alarm-seen:text-is('seen')")
        page.wait_for_selector("#alarm-line:not(:has-text('fragile'))")
        page.wait_for_function("!document.title.includes('fragile')")
        assert page.locator("#alarm-line").bounding_box() == before
