"""What bridges say about messages that they refuse because of their age."""

import logging
import math

import pytest

from robbie_mp.connect.bridge.arrivals import IN_A_ROW, AgeLog
from robbie_mp.connect.bridge.mapping import Incoming, Quality
from robbie_mp.messages import DriveCommand, NavigateTo

VELOCITIES = Incoming("/cmd_vel", "geometry_msgs/msg/Twist", "", DriveCommand, Quality())
GOALS = Incoming("/goal", "geometry_msgs/msg/PoseStamped", "", NavigateTo, Quality())


@pytest.mark.parametrize(
    ("incoming", "age_s", "text"),
    [
        (VELOCITIES, 0.4, "/cmd_vel are refused: they may be 0.4 s old; far"),
        (GOALS, 0.4, ""),
        (GOALS, math.inf, "unknown"),
    ],
)
def test_cause_is_said_once_when_many_messages_in_a_row_were_too_old(
    incoming: Incoming, age_s: float, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    ages = AgeLog(logging.getLogger(), "far")
    for one_s in [*[age_s] * (IN_A_ROW - 1), 0.1, *[age_s] * (3 * IN_A_ROW)]:
        ages.note(incoming, one_s, valid_for_s=0.3)
    assert len(caplog.messages) == (text != "")
    assert all(text in one for one in caplog.messages)
