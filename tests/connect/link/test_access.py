"""Only what the profile allows comes in; refusals are counted and traced, and a flood does no harm."""

import logging
from fnmatch import fnmatchcase

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.connect.link.access import (
    MAX_COUNTED,
    MAX_DECISIONS,
    MAX_RULES,
    OTHERS,
    AccessError,
    LinkAccess,
)
from robbie_mp.run.trace.log_limit import LOG_BURST

TWIST = "geometry_msgs/msg/Twist"
SCAN = "sensor_msgs/msg/LaserScan"
LOG = logging.getLogger(__name__)
NAMES = st.text("ab*?", max_size=3)


def access(**accept: list[str]) -> LinkAccess:
    return LinkAccess(accept, LOG)


def test_nothing_is_allowed_without_a_rule() -> None:
    assert not access().allows("laptop", TWIST, "cmd_vel")
    assert not access(laptop=[]).allows("laptop", TWIST, "cmd_vel")


def test_rule_allows_its_type_and_topic_from_its_robot_only() -> None:
    checked = access(laptop=["Twist cmd_vel", "robbie/msg/* operator/*"])
    assert checked.allows("laptop", TWIST, "cmd_vel")
    assert checked.allows("laptop", "robbie/msg/Order", "operator/orders")
    assert not checked.allows("laptop", TWIST, "other")
    assert not checked.allows("laptop", SCAN, "cmd_vel")
    assert not checked.allows("robot2", TWIST, "cmd_vel")
    assert not checked.allows("LAPTOP", TWIST, "cmd_vel")


def test_rule_without_a_topic_allows_all_topics() -> None:
    assert access(laptop=[SCAN]).allows("laptop", SCAN, "laser/front")
    assert access(laptop=["LaserScan"]).allows("laptop", SCAN, "")


def test_patterns_of_robots_add_to_each_other() -> None:
    checked = LinkAccess({"*": ["LaserScan"], "robot?": ["Twist"]}, LOG)
    assert checked.allows("robot2", SCAN, "") and checked.allows("robot2", TWIST, "")
    assert checked.allows("laptop", SCAN, "") and not checked.allows("laptop", TWIST, "")


@given(
    st.dictionaries(
        st.text("ab*?", min_size=1, max_size=3),
        st.lists(st.text("ab/*?", min_size=1, max_size=4), max_size=3),
    ),
    st.lists(st.tuples(NAMES, NAMES, NAMES), max_size=8),
)
def test_what_is_allowed_never_depends_on_what_was_asked_before(
    accept: dict[str, list[str]], asked: list[tuple[str, str, str]]
) -> None:
    checked = LinkAccess(accept, LOG)
    answers = [checked.allows(*one) for one in asked]
    assert answers == [LinkAccess(accept, LOG).allows(*one) for one in asked]
    assert checked.refused_total == answers.count(False)
    if not any(fnmatchcase(robot, name) for robot, _, _ in asked for name in accept):
        assert not any(answers)


def test_refusals_are_counted_by_channel_and_traced(caplog: pytest.LogCaptureFixture) -> None:
    checked = access()
    for _ in range(3):
        checked.allows("laptop", TWIST, "cmd_vel")
    checked.allows("laptop", SCAN, "")
    assert checked.refused == {f"{TWIST} on 'cmd_vel' from laptop": 3, f"{SCAN} from laptop": 1}
    assert checked.refused_total == 4
    assert (
        f"refused {TWIST} on 'cmd_vel' from laptop; the setting `accept` does not allow it" in caplog.messages
    )


def test_flood_of_strange_channels_is_counted_but_fills_neither_memory_nor_trace(
    caplog: pytest.LogCaptureFixture,
) -> None:
    checked = access()
    count = MAX_DECISIONS + 100
    for number in range(count):
        checked.allows("laptop", TWIST, f"flood{number}")
    assert checked.refused_total == count
    assert len(checked.refused) == MAX_COUNTED + 1
    assert checked.refused[OTHERS] == count - MAX_COUNTED
    assert len(caplog.records) <= LOG_BURST + 5
    assert len(checked._decisions) <= MAX_DECISIONS


def test_hostile_names_are_shown_on_one_line(caplog: pytest.LogCaptureFixture) -> None:
    access().allows("lap\ntop", "\x1b[2J", "a\nb")
    assert len(caplog.messages) == 1
    assert caplog.messages[0].isprintable()


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        ({"laptop": [""]}, "key 'laptop': element 0: expected a type, or a type and a topic"),
        ({"laptop": ["Twist", "Twist cmd_vel now"]}, "key 'laptop': element 1: .*got 'Twist cmd_vel now'"),
        ({"": ["Twist"]}, "expected the name of a robot"),
        ({"lap top": ["Twist"]}, "expected the name of a robot, .*got 'lap top'"),
        ({"laptop": ["Twist"] * (MAX_RULES + 1)}, f"more than {MAX_RULES} rules"),
    ],
)
def test_wrong_rule_is_an_error_that_says_which_and_what_is_right(
    accept: dict[str, list[str]], expected: str
) -> None:
    with pytest.raises(AccessError, match=expected):
        LinkAccess(accept, LOG)
