"""Reads the project's pages: their links, headings, and blocks of code."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
BLOCK = re.compile(
    r"^(?:<!-- (?P<mark>[^\n]*?) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
)
STEP = re.compile(rf"{BLOCK.pattern}|^<!-- (?P<alone>test: [^\n]*?) -->$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code, or a mark that stands alone (then without text)."""

    mark: str
    """What the comment above it says: `test: …`, `not tested: …`, or nothing."""
    language: str
    text: str


def blocks(page: str) -> list[Block]:
    """Blocks of a page and marks that stand alone, in order."""
    return [
        Block(match["mark"] or match["alone"] or "", match["language"] or "", match["text"] or "")
        for match in STEP.finditer((ROOT / page).read_text())
    ]


def block(page: str, mark: str) -> str:
    """The text of the one block with a mark."""
    (found,) = [entry.text for entry in blocks(page) if entry.mark == f"test: {mark}"]
    return found


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return BLOCK.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """What links into a page may name: its headings as GitHub makes them, and its own anchors."""
    text = prose(page)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    made = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return made | set(re.findall(r'<a name="(.*?)">', text))
