"""Links between the pages have targets."""

import re
from pathlib import Path

import pytest

from robbie_mp.cli.new import SUFFIX, TEMPLATE
from tests.docs._support.pages import PAGES, ROOT, anchors, blocks, prose

LINK = re.compile(r"\]\((?!https?:)([^)\s]+)\)")
MENTIONED = re.compile(r"`((?:robbie_mp|tests|modules|workers|hw|profiles|tools|docs)/[\w./]+)`")
TESTED = ("README.md", "docs/tutorial.md", "docs/how-to.md", "docs/calls.md", "docs/scene-graph.md")


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_link_has_a_target(page: Path) -> None:
    for link in LINK.findall(prose(page)):
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_project_file_that_a_page_names_exists(page: Path) -> None:
    written = {entry.mark.removeprefix("test: file ") for entry in blocks(name(page))}
    named = set(MENTIONED.findall(prose(page))) - written
    if "robbie new" in page.read_text():
        written |= {path.removesuffix(SUFFIX) for path in made_by_robbie_new()}
    assert not [path for path in named - written if not (ROOT / path).exists()]


def made_by_robbie_new() -> set[str]:
    template = ROOT / "robbie_mp" / "cli" / TEMPLATE
    return {path.relative_to(template).as_posix() for path in template.rglob(f"*{SUFFIX}")}


@pytest.mark.parametrize("page", TESTED)
def test_every_code_block_is_tested_or_marked_as_not_tested(page: str) -> None:
    code = [entry for entry in blocks(page) if entry.language in ("python", "sh", "yaml", "text")]
    assert code
    assert not [entry.text for entry in code if not entry.mark.startswith(("test: ", "not tested: "))]
