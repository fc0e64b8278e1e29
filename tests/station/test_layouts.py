"""Layouts fill the page with the panels that there are; what operators change outlives a restart."""

import logging
from pathlib import Path

import pytest

from robbie_mp.module.settings import SettingError, check_settings
from robbie_mp.station import OperatorStation
from robbie_mp.station.page.layouts import (
    Layout,
    LayoutCollection,
    LayoutError,
    check_layout,
    default_layouts,
    with_panel,
)
from robbie_mp.station.page.layouts.collection import MAX_SAVED
from robbie_mp.station.page.layouts.layout import COLUMNS, DEFAULTS, OWN, ROWS
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS
from tests._support.robot import wait_until

LOG = logging.getLogger("layouts")
WRONG = [
    ({"map": [0, 0, 24]}, "map needs [x, y, width, height] in cells"),
    ({"map": [0, 0, 12, 25]}, "map at [0, 0, 12, 25] does not fit: the grid has 24 columns"),
    ({"map": [0, 0, 1, 24]}, "a tile at least 2 of each"),
    ({"map": [0, 0, 12, 12], "drive": [11, 0, 4, 4]}, "the tiles of map and drive overlap"),
    ({"mapp": [0, 0, 12, 12]}, "there is no panel 'mapp'; expected one of drive, view, map"),
]


def cells(layout: Layout) -> int:
    """The number of covered cells; two tiles never cover the same."""
    covered = [cell for tile in layout for cell in tile.cells]
    assert len(covered) == len(set(covered))
    return len(covered)


def test_own_layouts_fill_the_page_with_the_panels_there_are() -> None:
    without = [name for name in FRAMEWORK_PANELS if name != "map"]
    for upright in (False, True):
        found = default_layouts([*FRAMEWORK_PANELS, "mission"], ["mission"], upright=upright)
        assert [*found] == [*DEFAULTS]
        for name, layout in found.items():
            expected = {"mission" if one == OWN else one for one in DEFAULTS[name]}
            assert {tile.panel for tile in layout} == expected
            assert cells(layout) == COLUMNS * ROWS
        for layout in default_layouts(without, [], upright=upright).values():
            assert cells(layout) == COLUMNS * ROWS
    assert list(default_layouts(["system", "drive"], [])) == ["All"]


@pytest.mark.parametrize(("places", "error"), WRONG)
def test_impossible_layout_in_a_profile_is_refused_with_its_place(
    places: dict[str, list[int]], error: str
) -> None:
    values = check_settings(OperatorStation, {"layouts": {"Mine": places}})
    with pytest.raises(SettingError) as refused:
        OperatorStation.check(values)
    assert str(refused.value).startswith(f"Mine: {error}") or error in str(refused.value)
    assert refused.value.setting == "layouts"


def test_added_panel_takes_the_free_place_or_half_of_the_largest_tile() -> None:
    first = with_panel((), "map")
    assert first[0].cells == {(x, y) for x in range(COLUMNS) for y in range(ROWS)}
    second = with_panel(first, "drive")
    assert (second[0].width, second[1].width, second[1].x) == (12, 12, 12)
    assert with_panel((second[1],), "view")[1].x == 0
    assert with_panel(second, "map") is second


def test_changed_layouts_outlive_a_restart_and_can_be_reset(tmp_path: Path) -> None:
    file, panels = tmp_path / "layouts.json", ["map", "drive"]
    given = {"Mine": check_layout("Mine", {"map": [0, 0, 24, 24]}, panels)}
    changed = check_layout("Mine", {"map": [0, 0, 12, 24], "drive": [12, 0, 12, 24]}, panels)
    layouts = LayoutCollection(given, panels, file, LOG)
    layouts.save("Mine", changed)
    layouts.save("Other", changed)
    wait_until(lambda: LayoutCollection(given, panels, file, LOG).names == ["Mine", "Other"])
    restarted = LayoutCollection(given, panels, file, LOG)
    assert restarted.get("Mine") == changed
    assert LayoutCollection(given, ["map"], file, LOG).get("Other") == changed[:1]
    restarted.forget("Mine")
    assert restarted.get("Mine") == given["Mine"]
    wait_until(lambda: not LayoutCollection(given, panels, file, LOG).is_changed("Mine"))


def test_layout_for_upright_pages_is_changed_by_itself(tmp_path: Path) -> None:
    file, panels = tmp_path / "layouts.json", ["map", "drive"]
    wide = check_layout("Mine", {"map": [0, 0, 12, 24], "drive": [12, 0, 12, 24]}, panels)
    upright = check_layout("Mine", {"map": [0, 0, 24, 12], "drive": [0, 12, 24, 12]}, panels)
    changed = check_layout("Mine", {"map": [0, 0, 24, 18], "drive": [0, 18, 24, 6]}, panels)
    layouts = LayoutCollection({"Mine": wide, "Wide": wide}, panels, file, LOG, {"Mine": upright})
    assert [layouts.get("Mine"), layouts.get("Mine", upright=True)] == [wide, upright]
    assert layouts.get("Wide", upright=True) == wide
    layouts.save("Mine", changed, upright=True)
    layouts.save("Upright", changed, upright=True)
    wait_until(lambda: LayoutCollection({"Mine": wide}, panels, file, LOG).names == ["Mine", "Upright"])
    restarted = LayoutCollection({"Mine": wide}, panels, file, LOG, {"Mine": upright})
    assert [restarted.get("Mine"), restarted.get("Mine", upright=True)] == [wide, changed]
    assert restarted.get("Upright") == changed
    restarted.forget("Mine")
    assert restarted.get("Mine", upright=True) == upright


def test_number_and_names_of_saved_layouts_are_bounded(tmp_path: Path) -> None:
    layouts = LayoutCollection({}, ["map"], tmp_path / "layouts.json", LOG)
    for number in range(MAX_SAVED):
        layouts.save(f"{number}", with_panel((), "map"))
    with pytest.raises(LayoutError, match="20 layouts are saved already"):
        layouts.save("one more", with_panel((), "map"))
    with pytest.raises(LayoutError, match="1 to 30 characters"):
        layouts.save("x" * 31, with_panel((), "map"))


def test_damaged_file_of_layouts_is_reported_and_not_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "layouts.json"
    file.write_text('{"wide": {"Mine": {"map": [0, 0, 99, 1]}}, "upright": {}}')
    assert LayoutCollection({}, ["map"], file, LOG).names == []
    assert "the saved layouts cannot be used: Mine: map at [0, 0, 99, 1] does not fit" in caplog.text
