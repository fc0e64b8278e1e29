"""Limits in docs/reference.md are those of the code."""

import re

from robbie_mp.bus.transport import layout
from robbie_mp.run.profile.model import CoreLimits, MemoryLimits, QueueLimits, TraceSettings
from tests.docs._support.pages import PAGES, ROOT

TEXT = (ROOT / "docs" / "reference.md").read_text()
ROWS = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|[^|\n]*\|$", TEXT.split("## Limits")[1], re.MULTILINE))
MIB = 1 << 20


def test_limits_of_the_layout() -> None:
    assert ROWS["messages of a module that a subscriber waits for or holds"] == str(layout.MAX_OUTSTANDING)
    assert ROWS["pairs of type and topic that a module publishes or subscribes"] == str(
        layout.DECLARATION_COUNT
    )
    assert ROWS["patterns that a module subscribes by"] == str(layout.MAX_PATTERNS)
    assert ROWS["name or pattern of a type or topic"] == f"{layout.NAME_BYTES} bytes"
    assert ROWS["status line"] == f"{(layout.LINE_WORDS - 1) * 8} bytes"


def test_limits_of_the_profile() -> None:
    queue, memory, core = QueueLimits(), MemoryLimits(), CoreLimits()
    assert ROWS["messages and bytes that wait for a module"] == f"{queue.messages}, {queue.bytes // MIB} MiB"
    assert ROWS["memory of a module's messages"] == f"{memory.limit_bytes // MIB} MiB"
    assert ROWS["checkpoint"] == f"{memory.checkpoint_bytes // MIB} MiB"
    sizes = f"{core.handles}, {core.references}, {core.channels}, {core.subscriptions}"
    assert ROWS["messages, references, channels, subscriptions of a run"] == sizes


def test_limits_of_the_output() -> None:
    limits = TraceSettings()
    rate = f"{limits.burst_lines} at once, then {limits.lines_per_s:g}/s"
    assert ROWS["lines that a module prints, on each stream, and log records"] == rate
    assert f"the output of each process, as JSON lines; {limits.file_bytes // MIB} MiB each" in TEXT


def test_only_the_section_on_extras_says_how_to_install_one() -> None:
    pages = {page: page.read_text() for page in PAGES}
    assert sum("robbie-mp[" in text for text in pages.values()) == 1
    assert "robbie-mp[" in TEXT.partition("## Extras")[2].partition("\n## ")[0]


def test_every_extra_is_explained() -> None:
    table = (ROOT / "pyproject.toml").read_text().partition("[project.optional-dependencies]")[2]
    extras = re.findall(r"^([a-z0-9]+) = \[", table.partition("\n[")[0], re.MULTILINE)
    explained = TEXT.partition("## Extras")[2].partition("\n## ")[0]
    missing = [one for one in extras if f"`{one}`" not in explained]
    assert len(extras) > 15 and not missing
