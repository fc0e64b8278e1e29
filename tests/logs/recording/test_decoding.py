"""A logged message becomes the program's class, or the reason why not is reported."""

from pathlib import Path
from typing import Any

import pytest

from robbie_mp import Message, Upgrade, float32, float64, uint8
from robbie_mp.logs.recording.decoding import LogDecoder
from robbie_mp.logs.recording.errors import NotDecodable
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import LaserScan, SchemaError, TypeRegistry, VersionError, schema_text
from tests.logs.recording._support.logs import START_NS, LogFile, scan


class ChargeThen(Message, name="team_msgs/msg/Charge", version=1):
    percent: float32


def add_cells(fields: dict[str, Any]) -> dict[str, Any]:
    return {"ratio": fields["percent"] / 100, "cells": 6}


class ChargeNow(
    Message,
    name="team_msgs/msg/Charge",
    version=3,
    upgrades={1: Upgrade(lambda fields: fields), 2: Upgrade(add_cells)},
):
    ratio: float64
    cells: uint8


class ChargeWithoutStep(Message, name="team_msgs/msg/Charge", version=3, upgrades={1: Upgrade(add_cells)}):
    ratio: float64
    cells: uint8


def decoded(folder: Path, written: Message, *types: type[Message]) -> Message:
    path = folder / "a.mcap"
    with LogFile(path) as file:
        file.add(written)
    decoder = LogDecoder(TypeRegistry(types))
    with open_log(path) as log:
        (logged,) = log.messages()
        assert decoder.decode(logged) == decoder.decode(logged)
        return decoder.decode(logged)


def test_message_of_version_1_is_upgraded_to_version_3(tmp_path: Path) -> None:
    assert decoded(tmp_path, ChargeThen(percent=50), ChargeNow) == ChargeNow(ratio=0.5, cells=6)


def test_missing_step_is_reported_with_type_and_versions(tmp_path: Path) -> None:
    with pytest.raises(VersionError, match=r"team_msgs/msg/Charge: version 1 cannot become 3: .* 2 to 3"):
        decoded(tmp_path, ChargeThen(percent=50), ChargeWithoutStep)


def test_newer_version_than_ours_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(VersionError, match="version 3 was written, 1 is the newest here"):
        decoded(tmp_path, ChargeNow(ratio=0.5, cells=6), ChargeThen)


def test_unknown_type_is_read_with_the_schema_in_the_log(tmp_path: Path) -> None:
    message: Any = decoded(tmp_path, ChargeNow(ratio=0.5, cells=6))
    assert (message.ratio, message.cells, message.version) == (0.5, 6, 3)


def test_stock_types_are_known_without_being_named(tmp_path: Path) -> None:
    with LogFile(tmp_path / "a.mcap") as file:
        file.add(scan(7))
    with open_log(tmp_path / "a.mcap") as log:
        (message,) = map(LogDecoder().decode, log.messages())
    assert isinstance(message, LaserScan) and message == scan(7)


def test_version_of_foreign_messages_follows_from_their_layout(tmp_path: Path) -> None:
    now, then = ChargeNow(ratio=0.5, cells=6), ChargeThen(percent=50)
    with LogFile(tmp_path / "a.mcap") as file:
        for number, message in enumerate((now, then)):
            schema = schema_text(type(message)).encode()
            schema_id = file.writer.register_schema("team_msgs/msg/Charge", "ros2msg", schema)
            channel = file.writer.register_channel(f"/{number}", "cdr", schema_id)
            file.add_bytes(channel, message.encode(), START_NS)
    decoder = LogDecoder(TypeRegistry([ChargeNow]))
    with open_log(tmp_path / "a.mcap") as log:
        assert list(map(decoder.decode, log.messages())) == [now, now]


@pytest.mark.parametrize(
    ("encoding", "schema", "error", "what"),
    [
        ("json", b"float32 x", NotDecodable, "topic 't' are encoded as 'json'; only 'cdr'"),
        ("cdr", b"", NotDecodable, "no schema .* of team_msgs/msg/Charge of topic 't'"),
        ("cdr", b"wstring x", SchemaError, "wstring is not supported"),
    ],
)
def test_undecodable_messages_are_reported(
    tmp_path: Path, encoding: str, schema: bytes, error: type[Exception], what: str
) -> None:
    with LogFile(tmp_path / "a.mcap") as file:
        form = "ros2msg" if schema else ""  # an empty text would describe a type without fields
        schema_id = file.writer.register_schema("team_msgs/msg/Charge", form, schema)
        file.add_bytes(file.writer.register_channel("/t", encoding, schema_id), b"{}", START_NS)
    with open_log(tmp_path / "a.mcap") as log, pytest.raises(error, match=what):
        LogDecoder().decode(next(log.messages()))
