"""Writes message classes in Python from definitions of ROS 2, as a person would write them.

The classes of the stock types are imported. Requests and replies, goals, feedback and results get the base
classes with which modules serve and call them.
"""

import keyword
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from robbie_mp.base.visible_text import one_line, visible
from robbie_mp.messages.calls import (
    FEEDBACK_SUFFIX,
    GOAL_SUFFIX,
    REQUEST_SUFFIX,
    RESPONSE_SUFFIX,
    RESULT_SUFFIX,
)
from robbie_mp.messages.declaration import Constant
from robbie_mp.messages.errors import SchemaError
from robbie_mp.messages.field_types import DEFAULT, Field, FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import Message, fields_of
from robbie_mp.messages.primitives import PRIMITIVES
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.schema import SEPARATOR, layout, nested_types
from robbie_mp.messages.schema_parser import COMMENT, LINE, message_type_from_schema

CALL: Final = "call"
BASES: Final = {
    REQUEST_SUFFIX: "Request",
    RESPONSE_SUFFIX: "Reply",
    GOAL_SUFFIX: "Goal",
    FEEDBACK_SUFFIX: "Feedback",
    RESULT_SUFFIX: "Result",
}
PARTS: Final = {
    "srv": (RESPONSE_SUFFIX, REQUEST_SUFFIX),
    "action": (RESULT_SUFFIX, FEEDBACK_SUFFIX, GOAL_SUFFIX),
}
"""The messages in a file, in an order in which each has what it names."""
IN_FILE: Final = {
    "srv": (REQUEST_SUFFIX, RESPONSE_SUFFIX),
    "action": (GOAL_SUFFIX, RESULT_SUFFIX, FEEDBACK_SUFFIX),
}
"""The same in the order of the file."""
HALVES: Final = re.compile(r"^---\s*$", re.MULTILINE)
TYPING: Final = ("Annotated", "Any", "ClassVar", "Literal")
OURS: Final = ("Array", "DEFAULT", "FixedLength", "MaxLength", "Message")
TAKEN: Final = frozenset({*TYPING, *BASES.values(), *OURS, *PRIMITIVES, "float", "list", "np", "str"})
"""Names that the file needs itself."""
HEADINGS: Final = re.compile(r"(goal|result|feedback|request|response)s?( definition)?[.:]?", re.IGNORECASE)
"""Comments that say what the class says."""
WIDTH: Final = 100


class Interface(NamedTuple):
    """A file of ROS: a message, a service or an action.

    Attributes:
        package: the package.
        kind: msg, srv or action.
        name: its name.
        text: the text of the file.
    """

    package: str
    kind: str
    name: str
    text: str

    @property
    def parts(self) -> list[tuple[str, str]]:
        """Names and definitions of the messages in it, in an order in which each follows what it names."""
        base = f"{self.package}/{self.kind}/{self.name}"
        if self.kind == "msg":
            return [(base, self.text)]
        texts = HALVES.split(self.text)
        suffixes = IN_FILE[self.kind]
        if len(texts) != len(suffixes):
            raise SchemaError(f"{base}: {len(texts)} parts between lines `---`; expected {len(suffixes)}")
        found = dict(zip(suffixes, texts, strict=True))
        return [(base + suffix, found[suffix]) for suffix in PARTS[self.kind]]


@dataclass
class PythonSource:
    """Collects classes, and writes the file that declares them.

    Args:
        registry: the stock types.
        definitions: texts of the message types that others may have as fields, by `package/Name`.

    Attributes:
        left_out: what could not be written, and why.
        made: the types that are written, by name; classes as in ROS, without the field `call`.
    """

    registry: TypeRegistry
    definitions: Mapping[str, str]
    left_out: list[str] = field(default_factory=list)
    made: dict[str, type[Message]] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)
    """The Python names of classes, by type name."""
    _blocks: list[str] = field(default_factory=list)
    _imports: dict[str, set[str]] = field(default_factory=dict)

    def add(self, interface: Interface) -> None:
        """Add the classes of a file, and those that they have as fields; note why that cannot be."""
        try:
            types = [(name, text, self._made(name, text)) for name, text in interface.parts]
            for _, _, made in types:
                if any(one.name == CALL for one in fields_of(made)) and interface.kind != "msg":
                    raise SchemaError(f"{made.type_name}: its field {CALL!r} is Robbie-MP's own")
                for one in (made, *nested_types(made)):
                    if one.type_name not in self.registry:
                        _check_names(one)
        except SchemaError as error:
            self.left_out.append(str(error))
            return
        for name, text, made in types:
            if name in self.registry:
                self._compare(made, self.registry.get(name), interface.kind)
            elif name not in self.made:
                self._write(made, text)

    def text(self, heading: str) -> str:
        """Return the file.

        Args:
            heading: its docstring.
        """
        standard = "".join(
            f"from {module} import {_listed(names)}\n"
            for module, names in sorted(self._imports.items())
            if module == "typing"
        )
        numpy = "import numpy as np\n\n" if "numpy" in self._imports else ""
        own = "".join(
            f"from {module} import {_listed(names)}\n"
            for module, names in sorted(self._imports.items())
            if module not in ("typing", "numpy")
        )
        head = f'"""{_docstring([one_line(heading)])}"""\n\n{standard}{chr(10) * bool(standard)}{numpy}{own}'
        return "\n\n".join([head, *self._blocks])

    def _compare(self, made: type[Message], stock: type[Message], kind: str) -> None:
        """Report a type whose stock form, which is imported instead, has different fields."""
        own = layout(stock)[0 if kind == "msg" else 1 :]  # without the call's number
        if layout(made) != own:
            self.left_out.append(
                f"{made.type_name}: Robbie-MP's stock type of this name has different fields, so the robot "
                "cannot exchange it with nodes that use this one"
            )

    def _made(self, name: str, text: str) -> type[Message]:
        return message_type_from_schema(name, text + "".join(self._nested_texts(name, text)))

    def _nested_texts(self, owner: str, text: str) -> Iterator[str]:
        """Yield the definitions of all message types that occur in one."""
        waiting, seen = [(owner.partition("/")[0], text)], set()
        while waiting:
            package, found = waiting.pop()
            for line in found.splitlines():
                base = re.split(r"[\[<\s]", line.strip(), maxsplit=1)[0]
                short = base if "/" in base else f"{package}/{base}"
                if base == "Header" and short not in self.definitions:
                    short = "std_msgs/Header"
                if short not in seen and (definition := self._definition(short)) is not None:
                    seen.add(short)
                    waiting.append((short.partition("/")[0], definition))
                    yield f"\n{SEPARATOR}\nMSG: {short}\n{definition}\n"

    def _definition(self, short: str) -> str | None:
        return self.definitions.get(short.replace("/msg/", "/"))

    def _write(self, made: type[Message], text: str) -> None:
        """Write a class behind those that it has as fields."""
        for one in fields_of(made):
            self._use(one.type)
        name = made.type_name
        self.made[name] = made
        base, parameters = "Message", ""
        for suffix, kind in BASES.items():
            if name.endswith(suffix) and "/msg/" not in name:
                base, parameters = kind, self._parameters(name.removesuffix(suffix), kind)
        self._import("robbie_mp", base)
        head = f"class {self._name(made)}({base}{parameters}, name={_quoted(name)}):"
        if len(head) > WIDTH:
            head = f"class {self._name(made)}(\n    {base}{parameters},\n    name={_quoted(name)},\n):"
        comments = _Comments(text)
        lines = [head, f'    """{comments.about or _about(name)}"""', ""]
        for constant in made._constants:
            lines += comments.around(constant.name, self._constant(constant))
        for one in fields_of(made):
            lines += comments.around(one.schema_name, self._field(one))
        self._blocks.append("\n".join(lines).rstrip() + "\n")

    def _parameters(self, base: str, kind: str) -> str:
        """Return what stands behind `Request` or `Goal`: its replies, or its feedback and results."""
        suffixes = {"Request": (RESPONSE_SUFFIX,), "Goal": (FEEDBACK_SUFFIX, RESULT_SUFFIX)}.get(kind, ())
        names = [self._name(self._known(base + suffix)) for suffix in suffixes]
        return f"[{', '.join(names)}]" if names else ""

    def _use(self, kind: FieldType) -> None:
        """Import or write a class that another one has as a field."""
        element = kind.element if isinstance(kind, Items) else kind
        if not isinstance(element, Nested):
            return
        made, name = element.message, element.layout.type_name
        if name in self.registry:
            self._name(self.registry.get(name))
        elif name not in self.made:
            self._write(made, self._definition(name.replace("/msg/", "/")) or "")

    def _name(self, made: type[Message]) -> str:
        """Return the Python name of a class; import it if it is a stock one."""
        type_name = made.type_name
        if type_name not in self._names:
            found = _class_name(type_name)
            while found in TAKEN or keyword.iskeyword(found) or found in self._names.values():
                found = f"{_title(type_name.partition('/')[0])}{found}"
            self._names[type_name] = found
            if type_name in self.registry:
                known = self.registry.get(type_name)
                alias = f" as {found}" if found != known.__name__ else ""
                self._import(known.__module__, f"{known.__name__}{alias}")
        return self._names[type_name]

    def _import(self, module: str, name: str) -> None:
        self._imports.setdefault(module, set()).add(name)

    def _constant(self, constant: Constant) -> str:
        self._import("typing", "ClassVar")
        return (
            f"{constant.name}: ClassVar[{self._annotation(constant.type)}] = {self._literal(constant.value)}"
        )

    def _field(self, one: Field) -> str:
        if one.declared_default is DEFAULT:
            self._import("robbie_mp", "DEFAULT")
            return f"{one.name}: {self._annotation(one.type)} = DEFAULT"
        value = self._literal(one.declared_default)
        if isinstance(one.type, Numbers):
            self._import("numpy", "np")
            value = f"np.array({value}, np.{one.type.element.dtype})"
        return f"{one.name}: {self._annotation(one.type)} = {value}"

    def _annotation(self, kind: FieldType) -> str:
        match kind:
            case Primitive():
                return self._primitive(kind)
            case Text():
                return self._limited("str", max_length=kind.max_length)
            case Nested():
                return self._class(kind)
            case Numbers():
                self._import("robbie_mp", "Array")
                element = "bool" if kind.element.name == "bool" else self._primitive(kind.element)
                if kind.length is None:
                    return self._limited(f"Array[{element}]", max_length=kind.max_length)
                self._import("typing", "Literal")
                return f"Array[{element}, Literal[{kind.length}]]"
            case Items():
                return self._limited(f"list[{self._annotation(kind.element)}]", kind.length, kind.max_length)

    def _class(self, kind: Nested) -> str:
        return self._name(self._known(kind.layout.type_name))

    def _known(self, name: str) -> type[Message]:
        return self.registry.get(name) if name in self.registry else self.made[name]

    def _primitive(self, kind: Primitive) -> str:
        if kind.name != "bool":
            self._import("robbie_mp", kind.name)
        return kind.name

    def _limited(self, annotation: str, length: int | None = None, max_length: int | None = None) -> str:
        for name, number in (("FixedLength", length), ("MaxLength", max_length)):
            if number is not None:
                self._import("typing", "Annotated")
                self._import("robbie_mp", name)
                return f"Annotated[{annotation}, {name}({number})]"
        return annotation

    def _literal(self, value: Any) -> str:
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if isinstance(value, list):
            return f"[{', '.join(map(self._literal, value))}]"
        if isinstance(value, str):
            return _quoted(value)
        if isinstance(value, float) and not math.isfinite(value):
            return f'float("{value}")'
        return repr(value)


class _Comments:
    """The comments in a definition.

    Args:
        text: the definition.

    Attributes:
        about: the first ones, if they stand alone.
    """

    def __init__(self, text: str):
        self.about = ""
        self._of: dict[str, list[str]] = {}
        pending: list[str] = []
        last, is_first = "", True
        for line in text.splitlines():
            content = COMMENT.sub(lambda found: found[1] or "", line).strip()
            comment = line.strip()[len(content) :].strip().removeprefix("#").strip() if "#" in line else ""
            comment = "" if HEADINGS.fullmatch(comment) else visible(comment)
            parts = LINE.fullmatch(content)
            if parts:
                last, is_first = parts["name"], False
                self._of[last] = [*pending, *([comment] if comment else [])]
                pending = []
            elif comment and line[:1].isspace() and last:
                self._of[last].append(comment)
            elif comment or line.startswith("#"):
                last = ""
                pending += [comment] if comment or pending else []
            elif not line.strip():
                last = ""
                if is_first and pending:
                    self.about = _docstring(pending)
                    pending, is_first = [], False
        if is_first and pending and not self._of:
            self.about = _docstring(pending)

    def around(self, name: str, declaration: str) -> list[str]:
        """Return a declaration with its comments."""
        found = [one for one in self._of.get(name, []) if one.strip("=-# ")]
        line = f"    {declaration}"
        if len(found) == 1 and len(line) + len(found[0]) + 4 <= WIDTH:
            return [f"{line}  # {found[0]}"]
        return [*(f"    # {one}" for one in found), line]


def _check_names(made: type[Message]) -> None:
    """Check that the names in a definition, which may come from anywhere, mean what they say in Python.

    Raises:
        SchemaError: one does not.
    """
    hidden = {*TAKEN, *(_class_name(one.type_name) for one in nested_types(made))}
    for name in (*(one.name for one in made._constants), *(one.name for one in fields_of(made))):
        if keyword.iskeyword(name) or name in hidden:
            raise SchemaError(f"{made.type_name}: its {name!r} would hide what is called so in Python")
        if not name.isascii():
            raise SchemaError(f"{made.type_name}: {name!r} is not a name in ROS")
    if not made.type_name.isascii():
        raise SchemaError(f"{made.type_name!r} is not a name in ROS")


def _docstring(lines: list[str]) -> str:
    while not lines[-1]:
        lines.pop()
    text = [one.replace("\\", "/").replace('"""', "'''") for one in lines]
    first, *others = text
    rest = "\n".join(f"    {one}".rstrip() for one in others)
    ends_quoted = text[-1].endswith('"')
    return f"{first}\n{rest}\n    " if others else f"{first}{'.' * (ends_quoted or first[-1:].isalnum())}"


def _about(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    for suffix, what in (
        (REQUEST_SUFFIX, "A request to"),
        (RESPONSE_SUFFIX, "The reply of"),
        (GOAL_SUFFIX, "A goal for"),
        (FEEDBACK_SUFFIX, "Feedback of"),
        (RESULT_SUFFIX, "The result of"),
    ):
        if kind != "msg" and name.endswith(suffix):
            return f"{what} {package}/{name.removesuffix(suffix)}."
    return f"{package}/{name} of ROS 2."


def _class_name(type_name: str) -> str:
    """Return the name of a class: that of ROS, but a request and a goal are called as their file."""
    _, kind, name = type_name.split("/")
    if kind == "msg":
        return name
    for suffix in (REQUEST_SUFFIX, GOAL_SUFFIX):
        name = name.removesuffix(suffix)
    return name.replace(RESPONSE_SUFFIX, "Reply").replace("_", "")


def _title(package: str) -> str:
    return "".join(word.title() for word in package.removesuffix("_msgs").split("_"))


def _quoted(text: str) -> str:
    escaped = text.encode("unicode_escape").decode().replace('"', '\\"')
    return f'"{escaped}"'


def _listed(names: Iterable[str]) -> str:
    """Return names for an import, in the order in which ruff sorts them."""
    ordered = sorted(names, key=_order)
    line = ", ".join(ordered)
    if len(line) < WIDTH - 30:
        return line
    return "(\n" + "".join(f"    {name},\n" for name in ordered) + ")"


def _order(name: str) -> tuple[int, list[tuple[str, int]]]:
    kind = 0 if name.isupper() else 1 if name[:1].isupper() else 2
    parts = re.findall(r"(\D*)(\d*)", name)
    return kind, [(text, int(number or 0)) for text, number in parts]
