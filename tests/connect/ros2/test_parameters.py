"""Settings as parameters, asked for by a plain session of Zenoh; rosbags writes requests, reads responses."""

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robbie_mp import Module, ModuleHarness, setting
from robbie_mp.connect.ros2.parameters import SERVICES
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.setting_changes import SettingChanges, SettingsFile
from tests._support.robot import Robot, wait_until
from tests.connect.ros2.test_robots import PROFILE
from tests.connect.ros2.test_zenoh import Bridge, Node, free_port, network, session, until, zenoh_has_started

__all__ = ["zenoh_has_started"]
# From the type descriptions that ROS 2 Jazzy installs (share/rcl_interfaces/srv/*.json).
HASHES = {
    "ListParameters": "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    "GetParameters": "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    "GetParameterTypes": "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
    "SetParameters": "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    "SetParametersAtomically": "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
    "DescribeParameters": "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
}
TEXTS = {
    "ListParameters_Request": "string[] prefixes\nuint64 depth",
    "ListParameters_Response": "rcl_interfaces/ListParametersResult result",
    "GetParameters_Request": "string[] names",
    "GetParameters_Response": "rcl_interfaces/ParameterValue[] values",
    "GetParameterTypes_Request": "string[] names",
    "GetParameterTypes_Response": "uint8[] types",
    "DescribeParameters_Request": "string[] names",
    "DescribeParameters_Response": "rcl_interfaces/ParameterDescriptor[] descriptors",
    "SetParameters_Request": "rcl_interfaces/Parameter[] parameters",
    "SetParameters_Response": "rcl_interfaces/SetParametersResult[] results",
    "SetParametersAtomically_Request": "rcl_interfaces/Parameter[] parameters",
    "SetParametersAtomically_Response": "rcl_interfaces/SetParametersResult result",
}
ROS = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in TEXTS.items():
    ROS.register(get_types_from_msg(_text, f"rcl_interfaces/msg/{_name}"))
ARRAYS = {"byte": np.uint8, "bool": np.bool_, "integer": np.int64, "double": np.float64}
Ros = tuple[Bridge, Node]
NAMES = ["mapping.resolution_m", "mapping.size", "mapping.frame", "mapping.colors", "mapping.extra"]


class Mapping(Module):
    """A module with settings of several types."""

    resolution_m: float = setting(0.05, "edge of a cell", minimum=0.01, maximum=1.0, changeable=True)
    size: list[int] = setting([640, 480], "width and height", changeable=True)
    frame: str = setting("map", "its frame")
    colors: dict[str, int] = setting({"free": 1}, "of cells")
    extra: str | None = setting(None, "a note")


@pytest.fixture(scope="module")
def ros(zenoh_has_started: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    """A bridge with parameters, a router and a node."""
    file = SettingsFile(tmp_path_factory.mktemp("run"), "mapping")
    mapping = ModuleHarness(Mapping, name="mapping")
    SettingChanges(mapping.module, mapping.bus, file).listen()
    with network({"parameters": "change"}) as (bridge, node):
        assert bridge.module.node_parameters is not None
        bridge.module.node_parameters.files = {"mapping": file}
        yield bridge, node


def serialized(service: str, **fields: Any) -> bytes:
    request: Any = ROS.types[f"rcl_interfaces/msg/{service}_Request"](**fields)
    return bytes(ROS.serialize_cdr(request, request.__msgtype__))


def ask(ros: Ros, service: str, **fields: Any) -> Any:
    """Send a request, and return where its response comes."""
    snake = "".join(f"_{one.lower()}" if one.isupper() else one for one in service).removeprefix("_")
    key = f"7/red/{snake}/rcl_interfaces::srv::dds_::{service}_/RIHS01_{HASHES[service]}"
    return ros[1].ask(key, serialized(service, **fields))


def read(service: str, replies: Any) -> Any:
    data = replies.recv().ok.payload.to_bytes()
    return ROS.deserialize_cdr(data, f"rcl_interfaces/msg/{service}_Response")


def answered(ros: Ros, service: str, **fields: Any) -> Any:
    """Send a request and return the response, which needs nobody else."""
    before = ros[0].module.desk.handled
    replies = ask(ros, service, **fields)
    until(ros[0], lambda: ros[0].module.desk.handled > before)
    return read(service, replies)


def parameter(name: str, number: int, **value: Any) -> Any:
    empty: dict[str, Any] = {
        "bool_value": False,
        "integer_value": 0,
        "double_value": 0.0,
        "string_value": "",
        "string_array_value": [],
        **{f"{one}_array_value": np.array([], kind) for one, kind in ARRAYS.items()},
    }
    types = ROS.types
    found = types["rcl_interfaces/msg/ParameterValue"](type=number, **(empty | value))
    return types["rcl_interfaces/msg/Parameter"](name=name, value=found)


def test_parameter_services_have_the_hashes_that_ros_has_published() -> None:
    assert {name: f"RIHS01_{digits}" for name, digits in HASHES.items()} == {
        name: one.type_hash for name, one in SERVICES.items()
    }


def test_node_lists_and_gets_settings(ros: Ros) -> None:
    listed = answered(ros, "ListParameters", prefixes=[], depth=0).result
    assert sorted(listed.names) == sorted(NAMES)
    assert listed.prefixes == ["mapping"]
    assert answered(ros, "ListParameters", prefixes=[], depth=1).result.names == []
    assert len(answered(ros, "ListParameters", prefixes=["mapping"], depth=1).result.names) == len(NAMES)
    values = answered(ros, "GetParameters", names=[*NAMES, "mapping.nothing"]).values
    assert [one.type for one in values] == [3, 7, 4, 4, 0, 0]
    assert values[0].double_value == 0.05
    assert list(values[1].integer_array_value) == [640, 480]
    assert values[2].string_value == "map"
    assert values[3].string_value == "{free: 1}"
    types = answered(ros, "GetParameterTypes", names=["mapping.frame", "nobody.x"]).types
    assert list(types) == [4, 0]


def test_descriptions_say_what_can_be_changed_and_between_which_limits(ros: Ros) -> None:
    resolution, frame = answered(ros, "DescribeParameters", names=[NAMES[0], "mapping.frame"]).descriptors
    assert (resolution.name, resolution.type, resolution.read_only) == (NAMES[0], 3, False)
    assert resolution.description == "edge of a cell"
    (limits,) = resolution.floating_point_range
    assert (limits.from_value, limits.to_value) == (0.01, 1.0)
    assert frame.read_only


def test_module_decides_about_a_change(ros: Ros) -> None:
    bridge, _ = ros
    wanted = [
        parameter("mapping.resolution_m", 3, double_value=0.1),
        parameter("mapping.size", 7, integer_array_value=np.array([1, 2])),
        parameter("mapping.frame", 4, string_value="odom"),
    ]
    replies = ask(ros, "SetParameters", parameters=wanted)
    until(bridge, lambda: len([one for one in bridge.published if one.topic == "mapping"]) == 2)
    first, second = bridge.take(SettingChange, "mapping")
    assert (first.setting, first.value) == ("resolution_m", "0.1")
    assert (second.setting, second.value) == ("size", "[1, 2]")
    bridge.send(SettingChanged(request=second.request, error="too small"), topic="mapping")
    bridge.send(SettingChanged(request=first.request), topic="mapping")
    results = read("SetParameters", replies).results
    assert [one.successful for one in results] == [True, False, False]
    assert results[1].reason == "too small"
    assert "cannot be changed" in results[2].reason


def test_silent_module_is_reported(ros: Ros) -> None:
    bridge, _ = ros
    wanted = [parameter("mapping.resolution_m", 3, double_value=0.1)]
    replies = ask(ros, "SetParametersAtomically", parameters=wanted)
    until(bridge, lambda: bridge.take(SettingChange, "mapping"))
    bridge.advance(5.1)
    result = read("SetParametersAtomically", replies).result
    assert not result.successful
    assert "has not answered" in result.reason
    several = answered(ros, "SetParametersAtomically", parameters=wanted * 2).result
    assert "one after the other" in several.reason


@pytest.mark.slow
def test_node_changes_a_setting_of_a_running_robot(robot: Robot) -> None:
    port = free_port()
    robot.write_profile(PROFILE.format(port=port) + '  tuned: {class: "zoo.modules:Tunable"}\n')
    with ExitStack() as stack:
        stack.enter_context(session(mode="router", listen__endpoints=[f"tcp/127.0.0.1:{port}"]))
        node = Node(port, stack)
        robot.start()
        service = f"rcl_interfaces::srv::dds_::SetParameters_/RIHS01_{HASHES['SetParameters']}"
        wait_until(lambda: any(service in one for one in node.tokens()), 30.0)
        wanted = [parameter("tuned.gain", 2, integer_value=number) for number in (7, 101)]
        data = serialized("SetParameters", parameters=wanted)
        results = read("SetParameters", node.ask(f"7/robbie/set_parameters/{service}", data)).results
        assert [one.successful for one in results] == [True, False]
        assert "100" in results[1].reason
        assert robot.command("param", "get", "tuned.gain").stdout.strip() == "7"
