"""A class body declares the fields; what has no encoding is refused when the class is made."""

import subprocess
import sys
from typing import Annotated, Any, ClassVar

import pytest

from robbie_mp.messages import (
    Array,
    DeclarationError,
    FieldError,
    FixedLength,
    Header,
    LaserScan,
    MaxLength,
    Message,
    Quaternion,
    float32,
    schema_text,
    uint8,
)


def declare(
    annotation: object, name: str = "test_msgs/msg/Sample", field: str = "field", **body: object
) -> Any:
    """Make a class with one field, as a class statement would."""
    metaclass: Any = type(Message)
    return metaclass("Sample", (Message,), {"__annotations__": {field: annotation}, **body}, name=name)


def test_a_declaration_becomes_a_schema() -> None:
    class Report(Message, name="test_msgs/msg/Report", version=3):
        GOOD: ClassVar[uint8] = 7
        NAME: ClassVar[str] = "a b"
        header: Header
        ratio: float32 = 0.5
        label: Annotated[str, MaxLength(9)] = "none"
        ok: bool = True
        parts: list[Header]
        words: Annotated[list[str], FixedLength(2)]
        samples: Annotated[Array[uint8], MaxLength(4)]
        matrix: Array[float32, 4]  # type: ignore[valid-type]

    assert schema_text(Report).split("=" * 80)[0] == (
        "uint8 GOOD=7\n"
        'string NAME="a b"\n'
        "std_msgs/Header header\n"
        "float32 ratio 0.5\n"
        'string<=9 label "none"\n'
        "bool ok true\n"
        "std_msgs/Header[] parts\n"
        "string[2] words\n"
        "uint8[<=4] samples\n"
        "float32[4] matrix\n"
    )
    assert (Report.type_name, Report.version, Report.GOOD, Report.has_views) == (
        "test_msgs/msg/Report",
        3,
        7,
        True,
    )
    report = Report()  # type: ignore[call-arg]
    assert (report.ratio, report.label, report.ok, len(report.matrix)) == (0.5, "none", True, 4)


def test_only_types_with_numpy_arrays_in_them_have_views() -> None:
    assert LaserScan.has_views
    assert not Header.has_views
    assert declare(list[LaserScan]).has_views
    assert not declare(list[str]).has_views


@pytest.mark.parametrize(
    ("annotation", "advice"),
    [
        (int, "say which integer"),
        (float, "say which float"),
        (list[float32], "write Array"),
        (list[list[str]], "sequences of sequences"),
        (dict[str, str], "use a list of messages"),
        (object, "fields are"),
        (Annotated[float32, MaxLength(3)], "does not apply to a float32"),
        (Annotated[str, FixedLength(3)], "does not apply to a string"),
    ],
)
def test_what_has_no_encoding_is_refused_with_advice(annotation: object, advice: str) -> None:
    with pytest.raises(DeclarationError, match=advice) as caught:
        declare(annotation)
    assert "Sample.field" in str(caught.value)


def test_arrays_hold_primitives_only() -> None:
    with pytest.raises(DeclarationError, match=r"write list\[…\]"):
        Array[str]
    with pytest.raises(DeclarationError, match="an int >= 1"):
        Array[float32, 0]  # type: ignore[valid-type]


@pytest.mark.parametrize("field", ["class", "version", "encode", "self", "_hidden", "two__underscores"])
def test_a_field_cannot_take_a_name_that_is_needed_or_forbidden(field: str) -> None:
    with pytest.raises(DeclarationError, match="cannot have this name"):
        declare(uint8, field=field)


def test_a_name_that_python_needs_gets_an_underscore_in_python_only() -> None:
    assert schema_text(declare(uint8, field="class_")) == "uint8 class\n"


@pytest.mark.parametrize("name", ["", "Sample", "test_msgs/Sample", "test_msgs/msg/", "a/b/c/d"])
def test_a_type_needs_a_full_ros_name(name: str) -> None:
    with pytest.raises(DeclarationError, match='name="package_name/msg/Sample"'):
        declare(uint8, name=name)


def test_a_default_must_fit() -> None:
    with pytest.raises(FieldError, match=r"test_msgs/msg/Sample\.count: uint8 is 0 to 255, got 300"):
        declare(uint8, field="count", count=300)


def test_annotations_may_be_text() -> None:
    head = "from __future__ import annotations\nclass Late(Message, name='test_msgs/msg/Late'):\n    x: "
    namespace: dict[str, Any] = {"__name__": __name__, "Message": Message}
    exec(f"{head}Array[float32]", namespace)
    assert schema_text(namespace["Late"]) == "float32[] x\n"
    with pytest.raises(DeclarationError, match="Late: name 'Unknown' is not defined"):
        exec(f"{head}list[Unknown]", namespace)


def test_messages_do_not_inherit_from_messages() -> None:
    with pytest.raises(DeclarationError, match="nest one"):

        class Longer(LaserScan, name="test_msgs/msg/Longer"):
            more: float32


def test_a_class_may_have_methods_and_properties() -> None:
    assert Quaternion.from_yaw(0.5).yaw == pytest.approx(0.5)


def test_importing_the_messages_makes_nothing_for_their_encoding() -> None:
    code = (
        "import gc\n"
        "from robbie_mp.messages import stock_registry\n"
        "from robbie_mp.messages.codec.fields import Codec\n"
        "registry = stock_registry()\n"
        "assert not any(isinstance(each, Codec) for each in gc.get_objects())"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


class NumberedList(list[Any]):
    """Can be no field."""


@pytest.mark.parametrize(
    ("annotation", "written"),
    [
        (float32 | None, r"float32 \| None has no encoding; a message has no null: use NaN"),
        (dict[str, uint8], r"dict\[str, uint8\] has no encoding; use a list of messages, each with a key"),
        (dict, "dict has no encoding"),
        (set[Array[uint8]], r"set\[Array\[uint8\]\] has no encoding"),
        (tuple[Annotated[str, MaxLength(3)], ...], r"tuple\[Annotated\[str, MaxLength\(length=3\)\], "),
        (NumberedList, "NumberedList has no encoding"),
        (3, "3 has no encoding"),
    ],
)
def test_refused_type_is_named_as_its_author_wrote_it(annotation: object, written: str) -> None:
    with pytest.raises(DeclarationError, match=f"Sample.field: {written}") as refused:
        declare(annotation)
    assert "Primitive" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "value", "written"),
    [
        ("v", 3.0, "Sample.v has no type, so it is no field; write `v: float64 = 3.0`"),
        ("count", 3, "write `count: int32 = 3`"),
        ("is_ok", True, "write `is_ok: bool = True`"),
        ("word", "a", "write `word: str = 'a'`"),
        ("items", [1.0], "write `items: Array\\[float64\\] = "),
        ("header", Header(), "write `header: Header = "),
        ("nothing", None, "write `nothing: TYPE = None`"),
        ("version", 2, "write class Sample\\(Message, name=…, version=2\\)"),
    ],
)
@pytest.mark.parametrize("template", [False, True])
def test_value_without_a_type_is_no_field_and_refused(
    name: str, value: object, written: str, template: bool
) -> None:
    metaclass: Any = type(Message)
    with pytest.raises(DeclarationError, match=written):
        metaclass("Sample", (Message,), {name: value}, name="test_msgs/msg/Sample", template=template)


def test_constants_methods_and_private_names_need_no_type() -> None:
    class Sample(Message, name="test_msgs/msg/Sample"):
        FULL = 4
        TOO_NEAR_2 = 5
        _kept = 3
        limit: ClassVar[Any] = object()
        x: float32

        @property
        def double(self) -> float:
            return 2.0 * self.x

        @staticmethod
        def make() -> "Sample":
            return Sample(x=2.0)

        class Inner:
            """Belongs to it."""

    assert Sample.make().double + Sample.FULL + Sample._kept == 11.0
