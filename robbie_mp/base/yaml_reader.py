"""Reads YAML into a tree in which every value knows where it was written.

The scalars are those of the YAML 1.2 core schema (https://yaml.org/spec/1.2.2/#103-core-schema): only true
and false are booleans, so `no` is a str, and `1e-3` is a number. Tags that would build objects are refused.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import yaml

from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.base.problem import ProfileError, SourcePlace, refuse

TAG = "tag:yaml.org,2002:"
CORE_SCHEMA = {
    None: [
        (TAG + "null", re.compile(r"(?:~|null|Null|NULL|)\Z")),
        (TAG + "bool", re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")),
        (TAG + "int", re.compile(r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)\Z")),
        (
            TAG + "float",
            re.compile(
                r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
                r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z"
            ),
        ),
    ]
}
MAX_DEPTH = 32
MAX_VALUES = 100_000
"""A limit, because a few lines of nested aliases can expand to billions of values."""


@dataclass(frozen=True)
class YamlNode:
    """A value of a profile with its place; the values of a map have the places of their keys."""

    value: "dict[str, YamlNode] | list[YamlNode] | bool | int | float | str | None"
    place: SourcePlace

    def plain(self) -> object:
        """Return the value without places."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain() for child in self.value]
        return self.value


class Loader(yaml.SafeLoader):
    """PyYAML's loader with the scalars of the core schema."""

    yaml_implicit_resolvers = CORE_SCHEMA


class Dumper(yaml.SafeDumper):
    """Writes what `read_file` reads as it was. It has no aliases.

    It also quotes a str that means something else in YAML 1.1, for other programs that read the output.
    """

    yaml_implicit_resolvers = yaml.SafeDumper.yaml_implicit_resolvers | CORE_SCHEMA

    def ignore_aliases(self, data: object) -> bool:
        """Return that a value which is there twice is written twice."""
        return True


def read_file(file: Path) -> YamlNode:
    """Read a YAML file.

    Raises:
        ProfileError: the file cannot be read, is not UTF-8 or not YAML, or contains something that a profile
            may not contain.
    """
    try:
        with open_regular(file) as opened:
            content = opened.read()
    except OSError as error:
        raise refuse(f"cannot be read: {error.strerror}", SourcePlace(file, 1)) from None
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise refuse("expected UTF-8 text; got other bytes", SourcePlace(file, line)) from None
    return read_text(text, file)


def read_text(text: str, source: Path | str) -> YamlNode:
    """Read YAML text; an empty text is null.

    Args:
        text: One YAML document.
        source: The file it comes from, or the option of the command line.

    Raises:
        ProfileError: as `read_file`.
    """
    try:
        loader = Loader(text)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise refuse(f"YAML: character #x{error.character:04x} is not allowed", _at(source, line)) from None
    try:
        root = loader.get_single_node()
        return _Converter(source).convert(root) if root else YamlNode(None, _at(source, 1))
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, source) from None
    except ProfileError:
        raise
    except RecursionError:
        raise refuse(f"YAML: nested deeper than {MAX_DEPTH} levels", _at(source, loader.line + 1)) from None
    except (ValueError, OverflowError):  # PyYAML passes on the error of chr() for an escape like "\UFFFFFFFF"
        raise refuse("YAML: an escape names no character", _at(source, loader.line + 1)) from None
    finally:
        loader.dispose()


def _at(source: Path | str, line: int) -> SourcePlace:
    return SourcePlace(source, line if isinstance(source, Path) else 0)


def _syntax_error(error: yaml.MarkedYAMLError, source: Path | str) -> ProfileError:
    mark = error.problem_mark or error.context_mark
    text = " ".join(part for part in (error.context, error.problem) if part)
    if "'\\t'" in text:
        text += "; indent with spaces, not with tabs"
    elif "mapping values are not allowed" in text:
        text += "; quote a text with a colon in it, or check the indentation"
    elif "expected <block end>" in text:
        text += "; indent all keys of a map alike"
    if mark and "${" in (mark.get_snippet() or ""):
        text += '; inside { } and [ ], quote variables: "${name}"'
    return refuse(f"YAML: {text}", _at(source, mark.line + 1 if mark else 1))


class _Converter:
    """Converts PyYAML's nodes into ours."""

    def __init__(self, source: Path | str) -> None:
        self.source = source
        self.open: list[yaml.Node] = []
        self.count = 0

    def convert(self, node: yaml.Node, place: SourcePlace | None = None) -> YamlNode:
        """Convert a node; `place` is the place of its key, if it has one."""
        place = place or self.place_of(node)
        self.count += 1
        if self.count > MAX_VALUES:
            raise refuse(f"YAML: more than {MAX_VALUES} values, aliases counted in full", place)
        if any(node is outer for outer in self.open):
            raise refuse("YAML: an alias (*) inside the value that it refers to", place)
        if len(self.open) == MAX_DEPTH:
            raise refuse(f"YAML: nested deeper than {MAX_DEPTH} levels", place)
        self.open.append(node)
        try:
            if isinstance(node, yaml.MappingNode) and node.tag == TAG + "map":
                return YamlNode(self.convert_map(node), place)
            if isinstance(node, yaml.SequenceNode) and node.tag == TAG + "seq":
                return YamlNode([self.convert(child) for child in node.value], place)
            return YamlNode(self.convert_scalar(node, place), place)
        finally:
            self.open.pop()

    def convert_map(self, node: yaml.MappingNode) -> dict[str, YamlNode]:
        """Convert a map, whose keys must be different str."""
        result: dict[str, YamlNode] = {}
        for key_node, value_node in node.value:
            key, place = self.convert(key_node).value, self.place_of(key_node)
            if not isinstance(key, str):
                raise refuse(f"YAML: expected a str as key; got {key_node.value!r:.40}; quote it", place)
            if key in result:
                raise refuse(f"YAML: key {key!r} is set twice, first at {result[key].place}", place)
            if key == "<<" and key_node.style is None:
                raise refuse("YAML: merge keys (<<) are not supported; use a parent profile", place)
            result[key] = self.convert(value_node, place)
        return result

    def convert_scalar(self, node: yaml.Node, place: SourcePlace) -> bool | int | float | str | None:
        """Convert a scalar by its tag; the core schema gives it one if the file does not."""
        text, kind = node.value, node.tag.removeprefix(TAG)
        if not isinstance(node, yaml.ScalarNode) or kind not in ("null", "bool", "int", "float", "str"):
            raise refuse(f"YAML: tag {node.tag!r} is not supported", place)
        if kind == "str":
            return str(text)
        if not any(tag == node.tag and pattern.match(text) for tag, pattern in CORE_SCHEMA[None]):
            raise refuse(f"YAML: {text!r:.40} is not of type {kind}", place)
        if kind == "int":
            return self.convert_int(text, place)
        if kind == "float":
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        return text.lower() == "true" if kind == "bool" else None

    def convert_int(self, text: str, place: SourcePlace) -> int:
        """Convert an int, which must fit into 64 bits."""
        number = int(text, {"0o": 8, "0x": 16}.get(text[:2], 10)) if len(text) < 64 else 1 << 64
        if not -(1 << 63) <= number < 1 << 64:
            raise refuse(f"YAML: {text:.40} does not fit into 64 bits", place)
        return number

    def place_of(self, node: yaml.Node) -> SourcePlace:
        """Return where a node begins."""
        return _at(self.source, node.start_mark.line + 1)
