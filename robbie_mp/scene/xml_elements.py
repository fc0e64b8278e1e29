"""Reads XML into elements that know their lines. It refuses document types, and so entities."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from robbie_mp.base.problem import Problem, SourcePlace
from robbie_mp.scene.errors import SceneFileError

MAX_DEPTH = 64


@dataclass
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
        return next(iter(self.all(tag)), None)


def read_xml(file: Path) -> Element:
    """Read an XML file.

    Raises:
        SceneFileError: the file cannot be read, is not XML, or has a document type.
    """
    reader = _Reader(file)
    try:
        reader.parser.Parse(file.read_bytes(), True)
    except OSError as error:
        raise SceneFileError([Problem(f"cannot be read: {error.strerror}", SourcePlace(file, 1))]) from None
    except expat.ExpatError as error:
        text = f"not XML: {expat.ErrorString(error.code)}"
        raise SceneFileError([Problem(text, SourcePlace(file, error.lineno))]) from None
    except SceneFileError:
        raise
    except (LookupError, ValueError) as error:  # Python's errors for an unknown encoding
        raise SceneFileError([Problem(f"not XML: {error}", SourcePlace(file, 1))]) from None
    return reader.root


class _Reader:
    def __init__(self, file: Path) -> None:
        self.file = file
        self.root: Element
        self._open: list[Element] = []
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, self._place())
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
        raise SceneFileError([Problem(text, self._place())])

    def _place(self) -> SourcePlace:
        return SourcePlace(self.file, self.parser.CurrentLineNumber)
