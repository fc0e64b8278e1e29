"""The docs site has all pages and the whole interface; `make docs` itself checks links and docstrings."""

import re

import pytest

import robbie_mp
from tests.docs._support.pages import PAGES, ROOT
from tools.docs.diagrams import FOLDER, diagrams
from tools.docs.site import PAGES as PAGES_BESIDE_DOCS
from tools.docs.site import with_links_for_the_site, with_pictures

pytestmark = pytest.mark.slow

CONFIGURATION = (ROOT / "mkdocs.yml").read_text()
INTERFACE = "\n".join(page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))


@pytest.mark.parametrize("name", robbie_mp.__all__)
def test_interface_for_authors_is_documented(name: str) -> None:
    assert re.search(rf"^::: robbie_mp\.{name}$|`{name}(\[…\])?`", INTERFACE, re.MULTILINE)


def test_every_page_is_in_the_navigation() -> None:
    named = set(re.findall(r"[\w/-]+\.md", CONFIGURATION))
    of_docs = {
        page.relative_to(ROOT / "docs").as_posix() for page in PAGES if page.is_relative_to(ROOT / "docs")
    }
    assert named == of_docs | set(PAGES_BESIDE_DOCS.values())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("see [logs](docs/logs.md#look).", "see [logs](logs.md#look)."),
        ("![the map](docs/images/demo-map.png)", "![the map](images/demo-map.png)"),
        ("[how](CONTRIBUTING.md)", "[how](contributing.md)"),
        ("[demo](profiles/demo.yaml)", "`demo`"),
        ("[MCAP](https://mcap.dev) and [above](#look)", "[MCAP](https://mcap.dev) and [above](#look)"),
    ],
)
def test_links_lead_to_pages_of_the_site(text: str, expected: str) -> None:
    assert with_links_for_the_site(text) == expected


def test_each_diagram_has_a_picture_and_each_picture_a_diagram() -> None:
    assert {file.name for file in FOLDER.iterdir()} == set(diagrams()), "run python -m tools.docs.diagrams"


def test_diagrams_are_shown_as_pictures_and_other_code_as_it_is() -> None:
    text = "See:\n\n```mermaid\nflowchart TB\n```\n\n```python\npass\n```\n"
    shown = with_pictures(text, "api/module.md")
    assert shown.startswith("See:\n\n[![Diagram](../images/diagrams/")
    assert shown.endswith(".svg)\n\n```python\npass\n```\n")
