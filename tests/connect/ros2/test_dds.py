"""The bridge over DDS: the types made from declarations, and what is wrong on this machine."""

import os
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from robbie_mp import Message, ModuleHarness, float64, uint8
from robbie_mp.connect.ros2 import dds_side
from robbie_mp.connect.ros2.dds_side import NODES, DdsSide
from robbie_mp.connect.ros2.idl_types import raw_type
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.endpoints import ReliableReader
from robbie_mp.connect.ros2.rtps.participant import Participant
from robbie_mp.connect.ros2.side import Ros2Unavailable
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import DecodeError, Image, String
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.stock.registry import stock_registry
from tests.connect.ros2._support.ros_nodes import until

SETTINGS: dict[str, Any] = {"middleware": "dds", "domain": 20 + os.getpid() % 80}
TYPE_INFORMATION = 0x75
"""A parameter of an endpoint (DDS-XTypes 1.3, 7.6.2.1)."""


def test_padding_is_cut_off_and_other_bytes_behind_a_message_are_an_error() -> None:
    text = String(data="hello")
    data = text.encode()
    assert unpadded(text, data) is data
    assert unpadded(text, b"\x00\x01\x00\x02" + data[4:] + b"\x00\x00") == data
    with pytest.raises(DecodeError, match="4 bytes follow the message"):
        unpadded(text, data + bytes(4))


def test_missing_network_interface_is_named() -> None:
    with pytest.raises(Ros2Unavailable, match="cannot use the interface 'nope0'"):
        ModuleHarness(Ros2Bridge, {**SETTINGS, "interface": "nope0"}).__enter__()


@pytest.mark.slow
def test_every_stock_type_has_a_type_of_dds() -> None:
    for one in stock_registry():
        raw_type(one).__idl__.populate()
        raw_type(one).__idl__.fill_type_data()


def test_what_tells_of_nodes_is_the_type_that_ros_uses() -> None:
    assert type_hash(NODES) == "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"


@pytest.mark.slow
def test_publisher_that_cyclonedds_ignores_is_named_until_it_goes_also_after_many_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dds_side, "MAX_ENDPOINTS", 3)
    monkeypatch.setattr(dds_side, "FORGOTTEN_AFTER_LOOKS", 2)
    settings = {**SETTINGS, "accept": {"/text": "String"}, "emergency_stop": "engage"}
    whole = wire.parameter_list
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        side = bridge.module.side
        assert isinstance(side, DdsSide)
        with closing(Participant(SETTINGS["domain"], "lo", lambda _: False)) as other:
            for _ in range(4):
                other.add_writer("rt/text", "std_msgs::msg::dds_::String_", b"")
            until(bridge, lambda: len(side._seen) == 3)
        until(bridge, lambda: not side._seen)
        wrong = [(TYPE_INFORMATION, b"\xff" * 8)]
        monkeypatch.setattr(wire, "parameter_list", lambda told: whole([*told, *wrong]))
        with closing(Participant(SETTINGS["domain"], "lo", lambda _: False)) as other:
            other.add_writer("rt/text", "std_msgs::msg::dds_::String_", b"")
            until(bridge, lambda: "CycloneDDS ignores a publisher of /text" in bridge.module.degraded)
        until(bridge, lambda: not bridge.module.degraded)


@pytest.mark.slow
def test_reader_that_is_late_for_large_messages_gets_them_and_no_gap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gaps: list[int] = []
    monkeypatch.setattr(ReliableReader, "on_gap", lambda _self, _writer, start, *_: gaps.append(start))
    settings = {**SETTINGS, "send": {"Image": "/image depth=1"}, "parameters": "none"}
    with (
        ModuleHarness(Ros2Bridge, settings) as bridge,
        closing(Participant(SETTINGS["domain"], "lo", lambda one: one == "rt/image")) as peer,
    ):
        got: list[int] = []
        kind, told = "sensor_msgs::msg::dds_::Image_", f"typehash={type_hash(Image)};".encode()
        reader = peer.add_reader("rt/image", kind, told, lambda one: got.append(one.sequence), 1 << 24)
        bridge.send(_image())
        until(bridge, lambda: reader.writers)

        def has_come() -> bool:
            bridge.send(_image())
            return bool(got)

        until(bridge, has_come)
        first = got[0]
        with monkeypatch.context() as busy:
            busy.setattr(reader, "on_sample", lambda _: None)
            busy.setattr(reader, "on_heartbeat", lambda *_: None)
            for _ in range(4):
                bridge.send(_image())
        until(bridge, lambda: len(got) >= 5)
        assert got[:5] == [*range(first, first + 5)]
        assert not [one for one in gaps if one > first]


def _image() -> Image:
    return Image(height=100, width=500, step=1500, encoding="rgb8", data=np.zeros(150_000, np.uint8))


def test_bridge_ends_when_its_memory_is_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    with ModuleHarness(Ros2Bridge, {**SETTINGS, "max_memory_bytes": 256 << 20}) as bridge:
        monkeypatch.setattr(dds_side, "LOOK_NS", 0)
        bridge.advance(0.02)
        ballast = np.ones(300 << 20, np.uint8)
        with pytest.raises(Ros2Unavailable, match="more than `max_memory_bytes`"):
            bridge.advance(0.02)
        assert ballast[-1]


class OldGas(Message, name="nose_msgs/msg/Gas"):
    ppm: uint8


class NewGas(Message, name="nose_msgs/msg/Gas", version=2):
    ppm: float64


@pytest.mark.parametrize("first, second", [(OldGas, NewGas), (NewGas, OldGas)])
def test_message_is_sent_as_the_version_that_it_has_and_a_name_belongs_to_one_version(
    first: type[Message], second: type[Message]
) -> None:
    settings = {**SETTINGS, "send": {"nose_msgs/Gas": "/gas"}, "parameters": "none", "emergency_stop": "none"}
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        module = bridge.module
        module._types = KnownTypes(map(TypeDescription.of, (OldGas, NewGas)))
        for kind in (first, second, first):
            bridge.send(kind())
        assert (module.sent, module.unknown) == (2, 1)
        ((channel, _),) = (one for one in module._channels.values() if one)
        assert channel.type_hash == type_hash(first) == type_hash(module._type(channel))
        (said,) = module._named
        assert f"belongs to version {first.version}, and this is version {second.version}" in said
