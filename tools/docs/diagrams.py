"""Draws the Mermaid diagrams of the pages as pictures: `python -m tools.docs.diagrams`.

The docs site shows these pictures, so it needs no network and no script. A picture is named by the text that
it was drawn from. Needs playwright, Chromium, and the Mermaid that NiceGUI contains.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from playwright.sync_api import Page, Route

from tools.docs.site import DIAGRAM, DIAGRAMS, ROOT, picture_name
from tools.operator.chromium import chromium

FOLDER = ROOT / "docs" / DIAGRAMS
ORIGIN = "http://diagrams.invalid/"
"""Where the browser believes Mermaid to be; every request is answered from the files of NiceGUI."""
DRAW = """async ([name, text]) => {
  const { mermaid } = await import("./index.js");
  mermaid.initialize({
    startOnLoad: false, theme: "neutral", htmlLabels: false, deterministicIds: true,
    fontFamily: "Helvetica, Arial, sans-serif", flowchart: { htmlLabels: false },
  });
  return (await mermaid.render(name, text)).svg;
}"""


def diagrams() -> dict[str, str]:
    """Return the text of each diagram of the pages, by the name of its picture."""
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    texts = [match["text"] for page in pages for match in DIAGRAM.finditer(page.read_text())]
    return {picture_name(text): text for text in texts}


def main() -> None:
    """Draw what has no picture yet, and remove the pictures of diagrams that are gone."""
    argparse.ArgumentParser(prog="python -m tools.docs.diagrams", description=__doc__).parse_args()
    FOLDER.mkdir(exist_ok=True)
    wanted = diagrams()
    for file in FOLDER.iterdir():
        if file.name not in wanted:
            file.unlink()
    missing = {name: text for name, text in wanted.items() if not (FOLDER / name).exists()}
    for name, picture in drawn(missing):
        (FOLDER / name).write_text(picture)
        print(FOLDER / name)


def drawn(texts: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield the name and the SVG of each diagram."""
    with chromium() as browser:
        page = browser.new_page()
        page.route("**", _answer)
        page.goto(ORIGIN)
        for name, text in texts.items():
            yield name, _on_white(_draw(page, name, text))


def _answer(route: Route) -> None:
    from nicegui.elements import mermaid  # noqa: PLC0415 (it imports much)

    assert mermaid.__file__
    name = route.request.url.removeprefix(ORIGIN)
    if name:
        route.fulfill(path=Path(mermaid.__file__).parent / "dist" / name)
    else:
        route.fulfill(body="<!doctype html><body></body>", content_type="text/html")


def _draw(page: Page, name: str, text: str) -> str:
    picture: str = page.evaluate(DRAW, [f"diagram-{name.removesuffix('.svg')}", text])
    return picture


def _on_white(picture: str) -> str:
    """Let a picture be read on a dark page, too."""
    return picture.replace('style="', 'style="background: white; ', 1) + "\n"


if __name__ == "__main__":
    main()
