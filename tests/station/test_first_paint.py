"""The small file that the page loads first has the icons that our panels name."""

import re
from pathlib import Path

from robbie_mp.station.page.first_paint import STYLE, are_ours
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.map import MapPanel
from tools.operator.first_paint import ICON_NAMES

ROOT = Path(__file__).parents[2]
NAMED = re.compile(r'\bicon(?:: str)? ?= ?"(\w+)"|ui\.icon\("(\w+)"|set_icon\("(\w+)"')
CLASSES = re.compile(r'\.classes\("([^"]*)"')
SPACED = re.compile(r"[wh]-\d+|gap-\d+|text-(?:xs|sm)|font-bold|items-\w+")
"""Classes that only Tailwind has."""
AGAIN = "is not in the page's first file: run python -m tools.operator.first_paint"


def sources() -> list[str]:
    folders = (ROOT / "robbie_mp" / "station", ROOT / "modules")
    return [file.read_text() for folder in folders for file in folder.rglob("*.py")]


def test_file_has_all_icons_that_our_sources_name() -> None:
    known = set(ICON_NAMES.read_text().split())
    named = {name for text in sources() for found in NAMED.findall(text) for name in found if name}
    assert len(named) > 30
    assert not named - known, f"{named - known} {AGAIN}"


def test_file_has_all_styles_that_our_sources_name() -> None:
    style = STYLE.read_text()
    named = {name for text in sources() for found in CLASSES.findall(text) for name in found.split()}
    spaced = {name for name in named if SPACED.fullmatch(name)}
    assert len(spaced) > 10
    assert not (missing := {name for name in spaced if f".{name} {{" not in style}), f"{missing} {AGAIN}"


def test_only_panels_from_elsewhere_need_more() -> None:
    elsewhere = type("Own", (Panel,), {"__module__": "zoo.own_panel"})
    assert are_ours([MapPanel])
    assert not are_ours([MapPanel, elsewhere])
