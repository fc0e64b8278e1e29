"""Collects generated source, and compiles it so that tracebacks and debuggers show it."""

from __future__ import annotations

import builtins
import linecache
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INDENT = "    "
BUILTINS = ("Exception", "ValueError", "bytes", "len", "memoryview", "range", "str", "type")


class Source:
    """Lines of Python and the objects that they refer to.

    Names that begin with an underscore belong to the generated code, also the built-ins: a message may have
    fields named `len` or `type`.
    """

    def __init__(self) -> None:
        self.names: dict[str, Any] = {f"_{name}": getattr(builtins, name) for name in BUILTINS}
        self._lines: list[str] = []
        self._depth = 0

    @property
    def text(self) -> str:
        """All lines so far."""
        return "\n".join(self._lines) + "\n"

    def line(self, text: str) -> None:
        """Append a line at the current depth."""
        self._lines.append(INDENT * self._depth + text)

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """Append the head of a compound statement; lines appended inside the context form its body."""
        self.line(head)
        self._depth += 1
        yield
        self._depth -= 1

    def name(self, name: str, value: object) -> str:
        """Let the lines refer to `value` by this name, or by the name with a number if it is taken."""
        unique, count = name, 1
        while unique in self.names and self.names[unique] is not value:
            count += 1
            unique = f"{name}_{count}"
        self.names[unique] = value
        return unique

    def compile(self, file_name: str) -> dict[str, Any]:
        """Run the lines and return what they define, together with the names given before."""
        text = self.text
        # What inspect and traceback look lines up in; without a time stamp it is never taken for stale.
        linecache.cache[file_name] = (len(text), None, text.splitlines(keepends=True), file_name)
        namespace = dict(self.names)
        exec(compile(text, file_name, "exec"), namespace)
        return namespace
