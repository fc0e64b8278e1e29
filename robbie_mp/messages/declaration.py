"""Reads the declaration of a message class: annotations become fields and constants."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import ModuleType, NoneType, UnionType
from typing import Annotated, Any, ClassVar, NamedTuple, get_args, get_origin, get_type_hints

from robbie_mp.messages.errors import DeclarationError
from robbie_mp.messages.field_types import (
    DEFAULT,
    Field,
    FieldType,
    FixedLength,
    Items,
    MaxLength,
    MessageLayout,
    Nested,
    Numbers,
    Primitive,
    Text,
    constant_array,
)
from robbie_mp.messages.fitting import fit
from robbie_mp.messages.primitives import primitive_of, spelled

TYPE_NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*")
TAKEN_NAMES = frozenset(
    {
        "type_name",
        "version",
        "is_latched",
        "is_checked",
        "has_views",
        "has_rules",
        "flaw",
        "encoded_size",
        "encode_into",
        "encode",
        "decode",
        "forget_arrays",
        "self",
    }
)
"""Names that `Message` itself has, or that its methods need."""


class Constant(NamedTuple):
    """A named constant of a message type, as in `uint8 FULL=4`."""

    name: str
    type: Primitive | Text
    value: Any


class Upgrade(NamedTuple):
    """One step from a version of a message type to the next.

    Attributes:
        step: a function from the fields of the older version to those of the next.
        schema: the ros2msg text of the older version; None if it always accompanies the bytes.
    """

    step: Callable[[dict[str, Any]], dict[str, Any]]
    schema: str | None = None


class Declaration(NamedTuple):
    """The content of a message class's body."""

    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]


def read_declaration(
    class_name: str, type_name: str, namespace: Mapping[str, Any], leading: tuple[Field, ...] = ()
) -> Declaration:
    """Return the fields and constants that the namespace of a class body declares.

    Args:
        class_name: the name of the class.
        type_name: its ROS name.
        namespace: of its body.
        leading: the fields that it inherits.

    Raises:
        DeclarationError: the type name, or the name or annotation of a field, is not allowed.
        FieldError: a default does not fit its field.
    """
    if not TYPE_NAME.fullmatch(type_name):
        raise DeclarationError(
            f"{class_name}: its ROS name is {type_name!r}; write "
            f'class {class_name}(Message, name="package_name/msg/{class_name}")'
        )
    fields, constants = list(leading), []
    annotations = _annotations(class_name, namespace)
    _refuse_untyped(class_name, namespace, annotations)
    for name, annotation in annotations.items():
        if get_origin(annotation) is ClassVar:
            constants += _constant(name, get_args(annotation)[0], namespace)
        elif any(name == field.name for field in leading):
            raise DeclarationError(f"{class_name}.{name}: its base class already has a field of this name")
        else:
            fields.append(_field(class_name, type_name, name, annotation, namespace))
    return Declaration(tuple(fields), tuple(constants))


def read_fields(class_name: str, namespace: Mapping[str, Any]) -> tuple[Field, ...]:
    """Return the fields that the namespace of a template's body declares."""
    annotations = _annotations(class_name, namespace)
    _refuse_untyped(class_name, namespace, annotations)
    return tuple(
        _field(class_name, class_name, name, annotation, namespace)
        for name, annotation in annotations.items()
    )


def _annotations(class_name: str, namespace: Mapping[str, Any]) -> dict[str, Any]:
    """Return the annotations of a class body, evaluated by `typing` on a class with nothing else."""
    about = {
        name: namespace[name] for name in namespace if name.startswith("__annot") or name == "__module__"
    }
    try:
        return get_type_hints(type(class_name, (), about), include_extras=True)
    except NameError as error:
        raise DeclarationError(
            f"{class_name}: {error}; the types of fields must be defined before the class"
        ) from error


def _refuse_untyped(class_name: str, namespace: Mapping[str, Any], typed: Collection[str]) -> None:
    """Refuse a value without a type, which would be no field, unless it is clearly meant to be none.

    Raises:
        DeclarationError: there is one.
    """
    for name, value in namespace.items():
        is_private_or_constant = name.startswith("_") or name.isupper()
        is_code = (
            callable(value) or hasattr(type(value), "__get__") or isinstance(value, ModuleType | UnionType)
        )
        if name in typed or is_private_or_constant or is_code:
            continue
        if name == "version":
            advice = f"write class {class_name}(Message, name=…, version={value!r:.60})"
        else:
            kind, text = _type_for(value), f"{value!r:.60}"
            advice = (
                f"so it is no field; write `{name}: {kind} = {text}`, `{name}: ClassVar[{kind}] = {text}` "
                f"for a constant, or `del {name}` after its last use"
            )
        raise DeclarationError(f"{class_name}.{name} has no type, {advice}")


def _type_for(value: object) -> str:
    """Return the type of a field that may be meant by its default."""
    if isinstance(getattr(value, "_layout", None), MessageLayout):
        return type(value).__name__
    if isinstance(value, list | tuple) or hasattr(value, "dtype"):
        return "Array[float64]"
    return {"bool": "bool", "int": "int32", "float": "float64", "str": "str"}.get(
        type(value).__name__, "TYPE"
    )


def _constant(name: str, annotation: Any, namespace: Mapping[str, Any]) -> list[Constant]:
    """Return the constant; None for a class variable whose type ROS does not have."""
    kind = Text() if annotation is str else primitive_of(annotation)
    return (
        []
        if kind is None or name not in namespace
        else [Constant(name, kind, fit(name, kind, namespace[name]))]
    )


def _field(
    class_name: str, type_name: str, name: str, annotation: Any, namespace: Mapping[str, Any]
) -> Field:
    if name != python_name(name) or name.startswith("_") or "__" in name:
        advice = (
            f"call it {python_name(name)}, the schema will say {name}"
            if name.isidentifier()
            else "choose another name"
        )
        raise DeclarationError(f"{class_name}.{name}: a field cannot have this name; {advice}")
    kind = field_type(f"{class_name}.{name}", annotation)
    if namespace.get(name, DEFAULT) is DEFAULT:
        return Field(name, kind)
    default = fit(f"{type_name}.{name}", kind, namespace[name])
    return Field(name, kind, constant_array(default.copy()) if isinstance(kind, Numbers) else default)


def python_name(schema_name: str) -> str:
    """Return a field's name in Python: a reserved name gets an underscore at its end."""
    taken = keyword.iskeyword(schema_name) or schema_name in TAKEN_NAMES
    return f"{schema_name}_" if taken else schema_name


def field_type(path: str, annotation: Any) -> FieldType:
    """Return the field type of an annotation.

    Args:
        path: class and field, for the error text.
        annotation: such as `float32`, `Array[float32]`, `list[Point]`, `str`, a message class.

    Raises:
        DeclarationError: the annotation is not a field type.
    """
    if get_origin(annotation) is Annotated:
        plain, *notes = get_args(annotation)
        found = [note for note in notes if isinstance(note, FieldType)]
        kind = found[0] if found else field_type(path, plain)
        for note in notes:
            if isinstance(note, FixedLength | MaxLength):
                kind = _limited(path, kind, note)
        return kind
    if annotation is bool:
        return primitive_of(bool)  # type: ignore[return-value]
    if annotation is str:
        return Text()
    if get_origin(annotation) is list:
        return _items(path, get_args(annotation)[0])
    if isinstance(layout := getattr(annotation, "_layout", None), MessageLayout):
        return Nested(layout)
    raise DeclarationError(f"{path}: {spelled(annotation)} has no encoding; {_advice(annotation)}")


def _limited(path: str, kind: FieldType, note: FixedLength | MaxLength) -> FieldType:
    if isinstance(note, FixedLength) and isinstance(kind, Numbers | Items):
        return replace(kind, length=note.length)
    if isinstance(note, MaxLength) and isinstance(kind, Numbers | Items | Text):
        return replace(kind, max_length=note.length)
    raise DeclarationError(f"{path}: {note} does not apply to a {kind}")


def _items(path: str, annotation: Any) -> Items:
    element = field_type(path, annotation)
    if isinstance(element, Primitive):
        raise DeclarationError(
            f"{path}: write Array[{element}] for a sequence of numbers; it becomes a numpy array"
        )
    if isinstance(element, Numbers | Items):
        raise DeclarationError(f"{path}: ROS has no sequences of sequences; put the inner one into a message")
    return Items(element)


def _advice(annotation: Any) -> str:
    if annotation is int:
        return "say which integer: int8 to int64, uint8 to uint64"
    if annotation is float:
        return "say which float: float32 or float64"
    if NoneType in get_args(annotation):
        return "a message has no null: use NaN or an empty list, or a bool beside it"
    if dict in (annotation, get_origin(annotation)):
        return "use a list of messages, each with a key and a value"
    return "fields are primitives, bool, str, Array[…], list[…] of strings or messages, and messages"
