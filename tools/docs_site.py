"""Prepares the pages of the docs site, as a hook of mkdocs.

README.md, CONTRIBUTING.md and CHANGELOG.md lie beside `docs/`: this hook adds them to the site and adapts
their links.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.structure.files import Files

ROOT = Path(__file__).parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
LINK = re.compile(r"\[([^\]]*)\]\((?!https?:|#)([^)\s#]+)(#[^)\s]*)?\)")


def on_files(files: "Files", *, config: Any) -> "Files":
    """Add the pages that lie beside `docs/`."""
    from mkdocs.structure.files import File  # noqa: PLC0415 (the tests of this hook run without mkdocs)

    for source, name in PAGES.items():
        content = with_links_for_the_site((ROOT / source).read_text())
        files.append(File.generated(config, name, content=content))
    return files


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
