"""The settings of the robot's modules as parameters of the node, through ROS's services for parameters.

A parameter is called MODULE.SETTING. Its value is read from the run's folder when a node asks for it.
"""

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from robbie_mp.connect.ros2.desk import Desk, RosRequest
from robbie_mp.connect.ros2.service_types import service_type
from robbie_mp.messages import FieldError, SettingChange, SettingChanged, as_dict, from_dict
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.module.module import Module
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.run.profile.show import inline

NOT_SET, BOOL, INTEGER, DOUBLE, STRING, BYTES = 0, 1, 2, 3, 4, 5
"""Types of parameters (rcl_interfaces/msg/ParameterType)."""
LISTS: Final = 5
"""The type of a list is that of its elements and this."""
VALUES: Final = {
    BOOL: "bool_value",
    INTEGER: "integer_value",
    DOUBLE: "double_value",
    STRING: "string_value",
    BYTES: "byte_array_value",
    BOOL + LISTS: "bool_array_value",
    INTEGER + LISTS: "integer_array_value",
    DOUBLE + LISTS: "double_array_value",
    STRING + LISTS: "string_array_value",
}
"""Where a value stands, by its type."""
KINDS: Final = {"bool": BOOL, "int": INTEGER, "float": DOUBLE}
"""Types by kind of a setting; those of other kinds are texts."""
MAX_CHANGES = 64
"""Most changes that wait for their modules."""
MAX_RANGE = 2.0**62
"""Limits beyond this are no range in ROS."""
ANSWER_TIMEOUT_NS = 5_000_000_000
_VALUE = """uint8 type
bool bool_value
int64 integer_value
float64 double_value
string string_value
byte[] byte_array_value
bool[] bool_array_value
int64[] integer_array_value
float64[] double_array_value
string[] string_array_value"""
_NESTED = {
    "ParameterValue": _VALUE,
    "Parameter": "string name\nParameterValue value",
    "SetParametersResult": "bool successful\nstring reason",
    "ListParametersResult": "string[] names\nstring[] prefixes",
    "FloatingPointRange": "float64 from_value\nfloat64 to_value\nfloat64 step",
    "IntegerRange": "int64 from_value\nint64 to_value\nuint64 step",
    "ParameterDescriptor": """string name
uint8 type
string description
string additional_constraints
bool read_only
bool dynamic_typing
FloatingPointRange[<=1] floating_point_range
IntegerRange[<=1] integer_range""",
}
_SERVICES = {
    "ListParameters": "string[] prefixes\nuint64 depth\n---\nListParametersResult result",
    "GetParameters": "string[] names\n---\nParameterValue[] values",
    "GetParameterTypes": "string[] names\n---\nuint8[] types",
    "DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors",
    "SetParameters": "Parameter[] parameters\n---\nSetParametersResult[] results",
    "SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result",
}
SERVICES: Final = {
    name: service_type(f"rcl_interfaces/srv/{name}", text, **_NESTED) for name, text in _SERVICES.items()
}
"""ROS's services for parameters, by the last part of their types' names."""
PARAMETER_VALUE: Final = message_type_from_schema("rcl_interfaces/msg/ParameterValue", _VALUE)
Entry = dict[str, Any]


@dataclass
class _Change:
    """The changes that a node has requested, until all modules have answered."""

    asked: RosRequest
    results: list[tuple[bool, str] | None]
    is_atomic: bool


class NodeParameters:
    """Serves the settings of modules as parameters.

    Args:
        module: the bridge, in its `setup()`.
        desk: where the services are offered.
        node: full name of the node, as `/team/red`.
        files: the settings of each module.
        is_changeable: whether nodes may change those settings that can be changed.

    Attributes:
        changed: settings that nodes have changed.
        refused: changes that were refused, by this bridge or by the module.
    """

    def __init__(
        self,
        module: Module,
        desk: Desk,
        node: str,
        files: Mapping[str, SettingsFile],
        is_changeable: bool,
    ):
        self._module, self._is_changeable = module, is_changeable
        self.files = files
        self._waiting: dict[int, tuple[_Change, int, int]] = {}
        """Changes that wait for their module, by request: the change, its place in it, and until when."""
        self.changed = self.refused = 0
        for name, service, handler in (
            ("list_parameters", "ListParameters", self._list),
            ("get_parameters", "GetParameters", self._get),
            ("get_parameter_types", "GetParameterTypes", self._types),
            ("describe_parameters", "DescribeParameters", self._describe),
            ("set_parameters", "SetParameters", self._set),
            ("set_parameters_atomically", "SetParametersAtomically", self._set_atomically),
        ):
            desk.offer(f"{node}/{name}", SERVICES[service], handler)
        if is_changeable:
            module.subscribe(SettingChanged, self._on_changed, optional=True)

    def tick(self) -> None:
        """Give up on modules that do not answer; call this often."""
        now_ns = self._module.clock.monotonic_ns()
        for request, (change, place, until_ns) in list(self._waiting.items()):
            if now_ns >= until_ns:
                del self._waiting[request]
                self._end(change, place, "the module has not answered yet; it may still make the change")

    # -- reading -----------------------------------------------------------------------------------------

    def _all(self) -> dict[str, Entry]:
        return {
            f"{module}.{name}": entry
            for module, file in self.files.items()
            for name, entry in file.read().items()
        }

    def _list(self, asked: RosRequest) -> None:
        prefixes, depth = list(asked.request.prefixes), asked.request.depth
        names = [one for one in self._all() if _is_listed(one, prefixes, depth)]
        above = {one.rpartition(".")[0]: None for one in names}
        asked.answer(result={"names": names, "prefixes": list(above)})

    def _get(self, asked: RosRequest) -> None:
        known = self._all()
        asked.answer(values=[_value(known[one]) if one in known else {} for one in asked.request.names])

    def _types(self, asked: RosRequest) -> None:
        known = self._all()
        types = [_type(known[one]) if one in known else NOT_SET for one in asked.request.names]
        asked.answer(types=types)

    def _describe(self, asked: RosRequest) -> None:
        known = self._all()
        asked.answer(
            descriptors=[
                _descriptor(one, known[one], self._is_changeable) if one in known else {"name": one}
                for one in asked.request.names
            ]
        )

    # -- changing ----------------------------------------------------------------------------------------

    def _set(self, asked: RosRequest, is_atomic: bool = False) -> None:
        change = _Change(asked, [None] * len(asked.request.parameters), is_atomic)
        if not change.results:
            asked.answer(results=[])
        for place, parameter in enumerate(asked.request.parameters):
            problem = self._begin(change, place, parameter)
            if problem:
                self._end(change, place, problem)

    def _set_atomically(self, asked: RosRequest) -> None:
        if len(asked.request.parameters) == 1:
            self._set(asked, is_atomic=True)
            return
        self.refused += 1
        reason = "several settings cannot be changed at once; set one after the other"
        asked.answer(result={"successful": False, "reason": reason})

    def _begin(self, change: _Change, place: int, parameter: Any) -> str:
        """Ask the module to change a setting; return why that is not possible."""
        module, _, name = parameter.name.partition(".")
        entry = self.files[module].read().get(name) if module in self.files else None
        if entry is None:
            return f"there is no setting {parameter.name!r}"
        if not entry["changeable"] or not self._is_changeable:
            return "this setting cannot be changed now; set it in the profile"
        if parameter.value.type not in VALUES:
            return "a setting cannot be removed"
        if len(self._waiting) >= MAX_CHANGES:
            return "too many changes wait"
        request = secrets.randbits(63)
        text = _text(parameter.value, entry)
        if not self._module.publish(SettingChange(request=request, setting=name, value=text), topic=module):
            return "the bridge's memory is full"
        until_ns = self._module.clock.monotonic_ns() + ANSWER_TIMEOUT_NS
        self._waiting[request] = change, place, until_ns
        return ""

    def _on_changed(self, answer: SettingChanged) -> None:
        if answer.request in self._waiting:
            change, place, _ = self._waiting.pop(answer.request)
            self._end(change, place, answer.error)

    def _end(self, change: _Change, place: int, problem: str) -> None:
        """Note what came of one setting, and answer if it was the last."""
        self.refused += bool(problem)
        self.changed += not problem
        change.results[place] = not problem, problem
        done = [one for one in change.results if one is not None]
        if len(done) < len(change.results):
            return
        results = [{"successful": successful, "reason": reason} for successful, reason in done]
        if change.is_atomic:
            change.asked.answer(result=results[0])
        else:
            change.asked.answer(results=results)


def _is_listed(name: str, prefixes: list[str], depth: int) -> bool:
    """Whether `list_parameters` names a parameter; depth 0 means any depth."""
    if not prefixes:
        return not depth or name.count(".") < depth
    for prefix in prefixes:
        if name == prefix:
            return True
        rest = name.removeprefix(f"{prefix}.")
        if rest != name and (not depth or rest.count(".") < depth):
            return True
    return False


def _type(entry: Entry) -> int:
    outline = entry["outline"]
    if outline["kind"] == "map":
        return STRING
    return KINDS.get(outline["kind"], STRING) + (LISTS if outline["is_list"] else 0)


def _value(entry: Entry) -> dict[str, Any]:
    """Return a setting's value; what ROS has no type for is a text in YAML."""
    value = entry["value"]
    if value is None:
        return {}
    kind = _type(entry)
    try:
        return as_dict(from_dict(PARAMETER_VALUE, {"type": kind, VALUES[kind]: value}))
    except FieldError:  # a map, or a number that ROS cannot have
        return {"type": STRING, "string_value": inline(value)}


def _text(value: Any, entry: Entry) -> str:
    """Return a value from ROS in YAML, as a module expects it."""
    found = getattr(value, VALUES[value.type])
    if value.type == STRING:
        return found if entry["outline"]["kind"] == "map" else inline(found)
    if isinstance(found, np.ndarray):
        found = found.tolist()
    return inline(list(found) if isinstance(found, bytes) else found)


def _descriptor(name: str, entry: Entry, is_changeable: bool) -> dict[str, Any]:
    outline, kind = entry["outline"], _type(entry)
    lowest, highest = outline["minimum"], outline["maximum"]
    has_range = None not in (lowest, highest) and max(abs(lowest), abs(highest)) < MAX_RANGE
    choices = ", ".join(map(str, outline["choices"]))
    return {
        "name": name,
        "type": kind,
        "description": entry["description"],
        "additional_constraints": f"one of {choices}" if choices else entry["type"],
        "read_only": not (is_changeable and entry["changeable"]),
        "floating_point_range": [
            {"from_value": float(lowest), "to_value": float(highest)}
            for _ in range(has_range and kind == DOUBLE)
        ],
        "integer_range": [
            {"from_value": int(lowest), "to_value": int(highest), "step": 1}
            for _ in range(has_range and kind == INTEGER)
        ],
    }
