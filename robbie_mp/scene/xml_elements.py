"""Reads XML into elements that know their lines. It refuses document types, and so entities."""

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.base.problem import Problem, SourcePlace
from robbie_mp.scene.errors import SceneFileError

MAX_DEPTH = 64
MAX_BYTES = 32 << 20
MAX_ELEMENTS = 200_000
_DECLARED = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["']""")

_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


@dataclass(slots=True)
class Element:
    """An element of an XML file."""

    tag: str
    attributes: dict[str, str]
    place: SourcePlace
    children: list["Element"] = field(default_factory=list)

    def all(self, tag: str) -> list["Element"]:
        """Return the children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> "Element | None":
        """Return the first child with a tag; None if there is none."""
        return next((child for child in self.children if child.tag == tag), None)

    def walk(self) -> Iterator["Element"]:
        """Yield this element and all elements inside it."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))


def is_xml(content: bytes) -> bool:
    """Return whether the beginning of a file is XML: its first character is `<`, in any encoding."""
    return content.lstrip(codecs.BOM_UTF8 + codecs.BOM_UTF16_LE + b"\0 \t\r\n").startswith(b"<")


def read_content(file: Path, limit: int = MAX_BYTES) -> bytes:
    """Read a file of at most `limit` bytes.

    Raises:
        SceneFileError: it cannot be read, or is larger.
    """
    try:
        with open_regular(file) as opened:
            content = opened.read(limit + 1)
    except OSError as error:
        raise refused(f"cannot be read: {error.strerror}", file) from None
    if len(content) > limit:
        raise refused(f"larger than {limit >> 20} MiB", file)
    return content


def decoded(content: bytes, file: Path) -> str:
    """Return XML as text, by its byte order mark, else by the encoding that it declares, else as UTF-8.

    Raises:
        SceneFileError: it is in another encoding.
    """
    declared = _DECLARED.match(content)
    name = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    try:
        return content.decode(name or (declared[1].decode() if declared else "utf-8"))
    except (LookupError, ValueError) as error:
        raise refused(f"cannot be decoded: {error}", file) from None


def parse_xml(content: bytes, file: Path) -> Element:
    """Return the root of XML text.

    Args:
        content: the text.
        file: where it is from, for error texts.

    Raises:
        SceneFileError: it is not XML, has a document type, or is too large.
    """
    reader = _Reader(file)
    try:
        reader.parse(content)
    except expat.ExpatError as error:
        text = f"not XML: {expat.ErrorString(error.code)}"
        raise refused(text, file, error.lineno) from None
    except SceneFileError:
        raise
    except (LookupError, ValueError) as error:  # Python's errors for an unknown encoding
        raise refused(f"not XML: {error}", file) from None
    return reader.root


def refused(text: str, file: Path, line: int = 1) -> SceneFileError:
    """Return the error of a file with one problem."""
    return SceneFileError([Problem(text, SourcePlace(file, line))])


class _Reader:
    def __init__(self, file: Path) -> None:
        self.file = file
        self.root: Element
        self._open: list[Element] = []
        self._elements = 0
        self._prepare(None)

    def parse(self, content: bytes) -> None:
        try:
            self.parser.Parse(content, True)
        except ValueError as error:
            declared = _DECLARED.match(content)
            if declared is None or "multi-byte" not in str(error):
                raise
            # expat knows no multi-byte encodings but those of Unicode, and GBK and Shift JIS are in use
            self._prepare("utf-8")
            self.parser.Parse(content.decode(declared[1].decode()).encode(), True)

    def _prepare(self, encoding: str | None) -> None:
        self.parser = expat.ParserCreate(encoding)
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, SourcePlace(self.file, self.parser.CurrentLineNumber))
        self._elements += 1
        if self._elements > MAX_ELEMENTS:
            self._refuse(f"more than {MAX_ELEMENTS} elements")
        if len(self._open) == MAX_DEPTH:
            self._refuse(f"elements nested deeper than {MAX_DEPTH} levels")
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        self._open.pop()

    def _refuse_doctype(self, *_what: object) -> None:
        self._refuse("a document type (<!DOCTYPE …>) with its entities is not allowed; remove it")

    def _refuse(self, text: str) -> NoReturn:
        raise refused(text, self.file, self.parser.CurrentLineNumber)
