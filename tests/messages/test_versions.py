"""Old bytes become the message that the program has now, step by step."""

from typing import Any

import numpy as np
import pytest

from robbie_mp.messages import (
    Array,
    DecodeError,
    DriveCommand,
    FieldError,
    Header,
    JointCommand,
    Message,
    PanTiltCommand,
    Time,
    Upgrade,
    VersionError,
    as_dict,
    decode_version,
    float32,
    from_dict,
    message_type_from_schema,
    schema_text,
    uint8,
)

HEADER = f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
VERSION_1 = f"std_msgs/Header header\nfloat32 percent\nfloat32[] volts\n{HEADER}"
VERSION_2 = f"std_msgs/Header header\nfloat32 ratio\nfloat32[] volts\n{HEADER}"


def percent_to_ratio(fields: dict[str, Any]) -> dict[str, Any]:
    fields["ratio"] = fields.pop("percent") / 100
    return fields


def count_cells(fields: dict[str, Any]) -> dict[str, Any]:
    return {**fields, "cells": len(fields["volts"])}


class Battery(
    Message,
    name="test_msgs/msg/Battery",
    version=3,
    upgrades={1: Upgrade(percent_to_ratio, schema=VERSION_1), 2: Upgrade(count_cells)},
):
    header: Header
    ratio: float32
    volts: Array[float32]
    cells: uint8


def written(schema: str, **fields: object) -> bytes:
    return message_type_from_schema(Battery.type_name, schema)(**fields).encode()


NOW = Battery(header=Header(), ratio=0.5, volts=np.array([3.5, 4.0], np.float32), cells=2)


def test_the_oldest_version_takes_all_steps() -> None:
    assert decode_version(Battery, written(VERSION_1, percent=50.0, volts=NOW.volts), 1) == NOW


def test_the_schema_may_come_with_the_bytes() -> None:
    assert decode_version(Battery, written(VERSION_2, ratio=0.5, volts=NOW.volts), 2, VERSION_2) == NOW


def test_nested_messages_become_ours() -> None:
    old_header = message_type_from_schema("std_msgs/msg/Header", HEADER.split("Header\n")[1])(frame_id="pack")
    made = message_type_from_schema(Battery.type_name, VERSION_2)
    ours = Battery(header=Header(frame_id="pack"), ratio=0.0, volts=np.empty(0, np.float32), cells=0)
    old = made.decode(ours.encode()[:-1])
    assert type(old.header) is not Header and repr(old.header) == repr(old_header)  # type: ignore[attr-defined]
    assert decode_version(Battery, old.encode(), 2, VERSION_2).header == Header(frame_id="pack")


def test_our_own_version_is_decoded_directly() -> None:
    for schema in (None, schema_text(Battery), f"# said differently\n{schema_text(Battery)}"):
        assert decode_version(Battery, NOW.encode(), 3, schema) == NOW


def test_a_newer_version_is_refused() -> None:
    with pytest.raises(VersionError, match="Battery: version 4 was written, 3 is the newest here"):
        decode_version(Battery, NOW.encode(), 4)


def test_a_missing_step_is_named() -> None:
    class Gap(Message, name="test_msgs/msg/Gap", version=4, upgrades={1: Upgrade(dict), 3: Upgrade(dict)}):
        x: uint8

    with pytest.raises(VersionError, match="version 1 cannot become 4: the step from 2 to 3 is missing"):
        decode_version(Gap, b"", 1, "uint8 x")


def test_a_missing_schema_is_named() -> None:
    with pytest.raises(VersionError, match="version 2 came without a schema"):
        decode_version(Battery, b"", 2)


def test_other_fields_under_the_same_version_are_refused() -> None:
    with pytest.raises(VersionError, match="what was written as version 3 has other fields"):
        decode_version(Battery, NOW.encode(), 3, VERSION_2)


def test_a_step_that_fails_is_named() -> None:
    schema = VERSION_1.replace("percent", "per_cent")
    with pytest.raises(VersionError, match="the step from version 1 to 2 failed: KeyError"):
        decode_version(Battery, written(schema), 1, schema)


def test_what_the_steps_leave_must_fit() -> None:
    schema = VERSION_2.replace("float32 ratio", "string ratio")
    with pytest.raises(FieldError, match=r"test_msgs/msg/Battery\.ratio"):
        decode_version(Battery, written(schema, ratio="half"), 2, schema)


def test_damaged_bytes_of_an_old_version_are_a_decode_error() -> None:
    with pytest.raises(DecodeError, match=r"test_msgs/msg/Battery\.header"):
        decode_version(Battery, b"\x00\x01\x00\x00", 1)


@pytest.mark.parametrize("command", [DriveCommand, JointCommand, PanTiltCommand])
def test_command_of_an_old_log_rests_on_what_was_known_at_its_stamp(command: type[DriveCommand]) -> None:
    new = {"based_on", "unguarded", "by_hand"} | (
        {"valid_for"} if command.type_name == PanTiltCommand.type_name else set()
    )
    lines = schema_text(command).splitlines(keepends=True)
    schema = "".join(line for line in lines if line.split()[-1] not in new)
    written = message_type_from_schema(command.type_name, schema, 1)
    fields = as_dict(command(header=Header(stamp=Time(sec=7))))
    old = from_dict(written, {name: value for name, value in fields.items() if name not in new})
    assert decode_version(command, old.encode(), 1, schema).based_on == Time(sec=7)
