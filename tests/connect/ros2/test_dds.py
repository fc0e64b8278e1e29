"""The bridge over DDS beside a process with CycloneDDS's own types, and the types made from declarations."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.connect.ros2.dds_side import NODES
from robbie_mp.connect.ros2.idl_types import raw_type
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.side import Ros2Unavailable
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import DecodeError, DriveCommand, Header, LaserScan, String
from robbie_mp.messages.stock.registry import stock_registry
from tests._support.robot import wait_until

WITNESS = Path(__file__).with_name("dds_witness.py")
DOMAIN = 20 + os.getpid() % 80
SETTINGS = {
    "middleware": "dds",
    "domain": DOMAIN,
    "node": "red",
    "namespace": "team",
    "send": {"LaserScan": "/scan best_effort depth=5", "String": "/name latched depth=1"},
    "accept": {"/text": "String text latched", "/cmd_vel": "Twist as DriveCommand ros"},
}


def test_messages_pass_both_ways_and_the_node_is_seen(caplog: pytest.LogCaptureFixture) -> None:
    with ModuleHarness(Ros2Bridge, SETTINGS) as bridge:
        bridge.send(String(data="red robot"), topic="name")  # before anybody listens
        command = [sys.executable, str(WITNESS), str(DOMAIN)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as witness:
            told: dict[str, object] = {}

            def read() -> None:
                assert witness.stdout is not None
                for line in witness.stdout:
                    what, value = json.loads(line)
                    told[what] = value

            reading = threading.Thread(target=read)
            reading.start()
            scan = LaserScan(header=Header(frame_id="laser"), ranges=np.array([1.0, 2.5], np.float32))

            def is_done() -> bool:
                bridge.send(scan, topic="laser")
                bridge.advance(0.02)
                is_heard = bridge.published and bridge.published_encoded and bridge.module.inbox.strangers
                return len(told) == 6 and bool(is_heard)

            try:
                wait_until(is_done, 30.0)
            finally:
                witness.communicate()
                reading.join()
        assert told == {
            "scan": ["laser", [1.0, 2.5]],
            "name": "red robot",
            "nodes": [["/team", "red"]],
            "endpoint": ["sensor_msgs::msg::dds_::LaserScan_", f"typehash={type_hash(LaserScan)};"],
            "unfit": 1,
            "gids": 1,
        }
        assert String.decode(bridge.published_encoded[0].data) == String(data="from DDS")
        drive = bridge.take(DriveCommand, "ros")[-1]
        assert (drive.linear_m_per_s, drive.angular_rad_per_s) == (0.4, 0.1)
        assert 0 < drive.valid_for.nanoseconds <= 500_000_000
        assert bridge.module.side.incompatible >= 1
        bridge.advance(0.02)  # the tick after the one that counts it names it
        (named,) = [one for one in caplog.messages if "/scan has the type" in one]
        assert named.endswith("std_msgs::msg::dds_::String_")


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


def test_every_stock_type_has_a_type_of_dds() -> None:
    for one in stock_registry():
        raw_type(one).__idl__.populate()
        raw_type(one).__idl__.fill_type_data()


def test_what_tells_of_nodes_is_the_type_that_ros_uses() -> None:
    assert type_hash(NODES) == "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
