"""Triggers of the black box: how they are written, and when they fire."""

import pytest

from robbie_mp import SettingError
from robbie_mp.logs.black_box.module import BlackBox
from robbie_mp.logs.black_box.triggers import ChannelTriggers, FieldTrigger
from robbie_mp.messages import BatteryState, Bumper, EmergencyStop, Message
from robbie_mp.module.settings import check_settings


def fired(text: str, *messages: Message, topic: str = "battery") -> list[int]:
    """Return which of the messages fire a trigger."""
    trigger = FieldTrigger(text)
    kind = type(messages[0])
    field = trigger.field_of(kind.type_name, topic)
    watched = ChannelTriggers(kind.decode, {text: trigger.comparison(kind, field)})
    return [n for n, one in enumerate(messages) if list(watched.fired(memoryview(one.encode())))]


def test_trigger_fires_when_its_comparison_becomes_true() -> None:
    charges = [BatteryState(percentage=charge) for charge in (0.5, 0.09, 0.08, 0.5, float("nan"), 0.01)]
    assert fired("battery.percentage < 0.1", *charges) == [1, 5]
    assert fired("BatteryState.percentage >= 0.5", *charges, topic="") == [0, 3]


def test_lists_texts_and_flags_are_compared() -> None:
    assert fired("Bumper.pressed != []", Bumper(), Bumper(pressed=["left"]), Bumper()) == [1]
    stops = EmergencyStop(engaged=True, reason="fire"), EmergencyStop(engaged=False)
    assert fired("EmergencyStop.engaged == true", *stops) == [0]
    assert fired("EmergencyStop.reason == fire", *stops) == [0]


def test_trigger_is_about_its_topic_or_type_only() -> None:
    trigger = FieldTrigger("battery.percentage < 0.1")
    assert trigger.field_of("sensor_msgs/msg/BatteryState", "battery") == "percentage"
    assert trigger.field_of("sensor_msgs/msg/BatteryState", "other") == ""
    assert trigger.field_of("sensor_msgs/msg/BatteryState", "") == ""


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("battery", "is no trigger; write TOPIC.FIELD"),
        ("battery.percentage", "is no trigger"),
        ("battery < 5", "is no trigger"),
        ("battery.percentage < low", "needs a number"),
        ("BatteryState.percentag < 1", "did you mean 'percentage'"),
    ],
)
def test_wrong_trigger_is_refused_before_the_run_starts(text: str, complaint: str) -> None:
    with pytest.raises(SettingError, match=complaint):
        BlackBox.check(check_settings(BlackBox, {"triggers": [text]}))
