"""Prepares the pages of the docs site, as a hook of mkdocs.

README.md, CONTRIBUTING.md and CHANGELOG.md lie beside `docs/`: this hook adds them to the site and adapts
their links. It also shows diagrams as the pictures that `python -m tools.docs.diagrams` has drawn: Material
for MkDocs would load Mermaid from the network.
"""

import hashlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.structure.files import Files

ROOT = Path(__file__).parents[2]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
DIAGRAM = re.compile(r"^```mermaid\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
DIAGRAMS = "images/diagrams"
LINK = re.compile(r"\[([^\]]*)\]\((?!https?:|#)([^)\s#]+)(#[^)\s]*)?\)")


def on_files(files: "Files", *, config: Any) -> "Files":
    """Add the pages that lie beside `docs/`."""
    from mkdocs.structure.files import File  # noqa: PLC0415 (the tests of this hook run without mkdocs)

    for source, name in PAGES.items():
        content = with_links_for_the_site((ROOT / source).read_text())
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: "Files") -> str:
    """Show the diagrams of a page as pictures.

    Raises:
        PluginError: a diagram has no picture.
    """
    from mkdocs.exceptions import PluginError  # noqa: PLC0415

    for diagram in DIAGRAM.finditer(markdown):
        if not (ROOT / "docs" / DIAGRAMS / picture_name(diagram["text"])).exists():
            first = diagram["text"].partition("\n")[0]
            raise PluginError(
                f"{page.file.src_uri}: a diagram ({first}) has no picture; run python -m tools.docs.diagrams"
            )
    return with_pictures(markdown, page.file.src_uri)


def with_pictures(text: str, page: str) -> str:
    """Replace the diagrams of a page by their pictures, each a link to itself to look at it in full size.

    Args:
        text: the page.
        page: its path in `docs/`.
    """

    def shown(found: re.Match[str]) -> str:
        picture = "../" * page.count("/") + f"{DIAGRAMS}/{picture_name(found['text'])}"
        return f"[![Diagram]({picture})]({picture})"

    return DIAGRAM.sub(shown, text)


def picture_name(text: str) -> str:
    """Return the name of the picture of a diagram: it depends on the text from which it is drawn."""
    return f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.svg"


def with_links_for_the_site(text: str) -> str:
    """Make links of a page at the root of the repository lead to pages of the site.

    What is not on the site, such as a profile, keeps its text and loses its link.
    """

    def replace(link: re.Match[str]) -> str:
        words, target, anchor = link.group(1), link.group(2), link.group(3) or ""
        if target in PAGES:
            return f"[{words}]({PAGES[target]}{anchor})"
        if target.startswith("docs/"):
            return f"[{words}]({target.removeprefix('docs/')}{anchor})"
        return f"`{words}`"

    return LINK.sub(replace, text)
