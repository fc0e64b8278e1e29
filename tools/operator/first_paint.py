"""Writes the icons and styles that the operator's page needs first: `python -m tools.operator.first_paint`.

NiceGUI brings a font of 2234 icons (129 kB) and a compiler of styles (68 kB, and a second of a browser's
time). The page begins with a font of those icons that our sources name, and with the styles of those classes
that they use, which this compiler has made in Chromium. Needs fontTools and brotli; a robot needs neither.
"""

import argparse
import base64
import io
import re
from collections.abc import Iterator
from pathlib import Path

import nicegui
from fontTools.subset import Options, Subsetter, load_font
from fontTools.ttLib import TTFont

from robbie_mp.station.page.first_paint import STYLE
from tools.operator.chromium import chromium

ICON_NAMES = Path(__file__).with_name("first_paint_icons.txt")
"""The names of the icons in the font, for the tests."""
STATIC = Path(nicegui.__file__).parent / "static"
SOURCES = (Path("robbie_mp/station"), Path("modules"))
LIBRARIES = "gridstack"
WORD = re.compile(r"""["'](\w+)["']""")
TEXT = re.compile(r"\"([^\"\n]*)\"|`([^`]*)`")
MADE = ("light_mode", "dark_mode")
"""Icons whose names the page puts together."""
QUASAR_ICONS = re.compile(r'name:"material-icons",type:(.*?)\}\};', re.DOTALL)
EDITOR = re.compile(r"editor:\{.*?\},")
"""The icons of a component that no page of ours has."""
FONT = re.compile(r'font-family: "Material Icons";[^}]*?url\((.*?)\)')
LEAST = """<html><head><style type="text/tailwindcss">
@custom-variant dark (&:where(body.body--dark, body.body--dark *));
</style></head><body></body></html>"""
FACE = """/* A part of Google's Material Icons (Apache License 2.0). Written by tools.operator.first_paint. */
@font-face {
  font-family: "Material Icons"; font-style: normal; font-weight: 400; font-display: block;
  src: url(data:font/woff2;base64,%s) format("woff2");
}
"""
"""Outside all layers, so that it counts more than the face of NiceGUI, which has the same name."""
COMPILED = "() => [...document.querySelectorAll('style:not([type])')].map((one) => one.textContent).join('')"


def main() -> None:
    """Write the files."""
    argparse.ArgumentParser(prog="python -m tools.operator.first_paint", description=__doc__).parse_args()
    font = load_font(str(STATIC / font_file()), Options())
    names = sorted(named_icons() & ligatures(font).keys())
    icons = base64.b64encode(icons_only(font, names)).decode()
    STYLE.write_text(FACE % icons + compiled(sorted(named_classes())) + "\n")
    ICON_NAMES.write_text("\n".join(names) + "\n")
    print(f"{len(names)} icons; {STYLE}: {STYLE.stat().st_size} bytes")


def sources() -> Iterator[str]:
    """Yield the text of each source that may name an icon or a class."""
    for root in SOURCES:
        for file in sorted(root.rglob("*")):
            if file.suffix in (".py", ".js") and LIBRARIES not in file.name:
                yield file.read_text()


def named_icons() -> set[str]:
    """Return all words that may be names of icons: ours, and those of Quasar's components."""
    ours = {word for text in sources() for word in WORD.findall(text)}
    quasar = QUASAR_ICONS.search((STATIC / "quasar.umd.prod.js").read_text())
    assert quasar, "Quasar has its icons at another place"
    return ours | set(MADE) | set(WORD.findall(EDITOR.sub("", quasar[1])))


def named_classes() -> set[str]:
    """Return all words in texts that may be names of classes."""
    texts = (one or other for source in sources() for one, other in TEXT.findall(source))
    return {word for text in texts for word in text.split() if re.fullmatch(r"-?[a-z][\w./:%\[\]-]*", word)}


def font_file() -> str:
    """Return the file of NiceGUI's icons, in its folder."""
    found = FONT.search((STATIC / "fonts.css").read_text())
    assert found, "NiceGUI has its icons at another place"
    return found[1]


def ligatures(font: TTFont) -> dict[str, str]:
    """Return the glyphs of a font by the words that stand for them."""
    letters = {glyph: chr(code) for code, glyph in font.getBestCmap().items()}
    found = {}
    for lookup in font["GSUB"].table.LookupList.Lookup:
        for table in lookup.SubTable:
            for first, ends in table.ligatures.items():
                for end in ends:
                    word = "".join(letters[glyph] for glyph in (first, *end.Component))
                    found[word] = end.LigGlyph
    return found


def icons_only(font: TTFont, names: list[str]) -> bytes:
    """Return a font that has only these icons."""
    glyphs = ligatures(font)
    # Of the ligatures, only those of the icons stay, although the font has the letters of others.
    options = Options(layout_features=["*"], layout_closure=False, hinting=False)
    subsetter = Subsetter(options)
    subsetter.populate(glyphs=[glyphs[name] for name in names], text="".join(names))
    subsetter.subset(font)
    font.flavor = "woff2"
    data = io.BytesIO()
    font.save(data)
    return data.getvalue()


def compiled(classes: list[str]) -> str:
    """Return the styles that Tailwind makes of classes; words that are none add nothing."""
    with chromium() as started:
        page = started.new_page()
        page.set_content(LEAST)
        page.evaluate("(names) => document.body.className = names.join(' ')", classes)
        page.add_script_tag(path=STATIC / "tailwindcss.min.js")
        page.wait_for_function(f"({COMPILED})().includes('@layer utilities')")
        return str(page.evaluate(COMPILED))


if __name__ == "__main__":
    main()
