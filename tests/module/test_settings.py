"""Settings: each declared type takes what it should and refuses the rest by name."""

import math
from pathlib import Path
from typing import Optional

import pytest
from strenum import StrEnum

from robbie_mp import REQUIRED, RobbieError, SettingError, setting
from robbie_mp.module.settings import apply_settings, check_settings, settings_of


class Side(StrEnum):
    LEFT = "left"
    RIGHT = "right"


class Mapper:
    resolution_m: float = setting(0.05, "edge of a grid cell", minimum=0.01, maximum=1)
    threads: int = setting(1, "worker threads", minimum=1)
    verbose: bool = setting(False, "say more")
    frame: str = setting("map", "frame of the grid", choices=("map", "odom"))
    map_file: Path = setting(Path("map.png"), "where the map is kept")
    limit_s: float | None = setting(None, "give up after this")
    side: Side = setting(Side.LEFT, "where the sensor sits")
    offsets_m: list[float] = setting([], "offset of each sensor", minimum=0)
    weights: dict[str, float] = setting({}, "weight by sensor")
    anything_finite: float = setting(0.0, "may be infinite", finite=False)


class Player:
    file: Path = setting(REQUIRED, "log to play", must_exist=True)


def refusal(cls: type, **values: object) -> str:
    with pytest.raises(SettingError) as caught:
        check_settings(cls, values)
    assert isinstance(caught.value, RobbieError) and isinstance(caught.value, ValueError)
    return str(caught.value)


def test_unset_settings_have_their_defaults() -> None:
    checked = check_settings(Mapper, {}, folder=Path("/ws"))
    assert checked == {
        "resolution_m": 0.05,
        "threads": 1,
        "verbose": False,
        "frame": "map",
        "map_file": Path("/ws/map.png"),
        "limit_s": None,
        "side": Side.LEFT,
        "offsets_m": [],
        "weights": {},
        "anything_finite": 0.0,
    }


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("resolution_m", 1, 1.0),
        ("threads", 4, 4),
        ("verbose", True, True),
        ("frame", "odom", "odom"),
        ("limit_s", 3, 3.0),
        ("limit_s", None, None),
        ("side", "right", Side.RIGHT),
        ("offsets_m", [1, 2.5], [1.0, 2.5]),
        ("weights", {"front": 1}, {"front": 1.0}),
        ("anything_finite", math.inf, math.inf),
    ],
)
def test_right_value_becomes_the_declared_type(name: str, given: object, expected: object) -> None:
    value = check_settings(Mapper, {name: given})[name]
    assert value == expected
    assert type(value) is type(expected)


@pytest.mark.parametrize(
    ("name", "given", "text"),
    [
        ("resolution_m", "5", "expected float, at least 0.01 and at most 1; got '5' (str)"),
        ("resolution_m", True, "expected float, at least 0.01 and at most 1; got True (bool)"),
        ("resolution_m", 0, "expected float, at least 0.01 and at most 1; got 0.0 (float)"),
        ("resolution_m", 2.0, "expected float, at least 0.01 and at most 1; got 2.0 (float)"),
        ("resolution_m", math.nan, "expected float, at least 0.01 and at most 1, finite; got nan (float)"),
        ("resolution_m", None, "expected float, at least 0.01 and at most 1; got null"),
        ("limit_s", math.inf, "expected float, finite; got inf (float)"),
        ("limit_s", 10**400, "expected float; got an int that no float can hold"),
        ("threads", 1.0, "expected int, at least 1; got 1.0 (float)"),
        ("threads", True, "expected int, at least 1; got True (bool)"),
        ("threads", 0, "expected int, at least 1; got 0 (int)"),
        ("verbose", 1, "expected bool; got 1 (int)"),
        ("frame", "base", "expected str, one of 'map', 'odom'; got 'base' (str)"),
        ("map_file", "", "expected path; got '' (str)"),
        ("map_file", 7, "expected path; got 7 (int)"),
        ("map_file", "~nobody-of-this-name/x", "expected path; got '~nobody-of-this-name/x' (str)"),
        ("side", "middle", "expected one of left, right; got 'middle' (str)"),
        ("offsets_m", 1.0, "expected list of float; got 1.0 (float)"),
        ("offsets_m", [0, -1], "element 1: expected float, at least 0; got -1.0 (float)"),
        ("weights", [1], "expected map of str to float; got [1] (list)"),
        ("weights", {1: 1}, "expected map of str to float; got {1: 1} (dict)"),
        ("weights", {"front": "x"}, "key 'front': expected float; got 'x' (str)"),
    ],
)
def test_wrong_value_is_refused_by_name(name: str, given: object, text: str) -> None:
    assert refusal(Mapper, **{name: given}) == f"Mapper.{name}: {text}"


def test_infinite_bound_does_not_admit_not_a_number() -> None:
    class Open:
        x: float = setting(0.0, "any", minimum=0, finite=False)

    assert check_settings(Open, {"x": math.inf}) == {"x": math.inf}
    assert "got nan" in refusal(Open, x=math.nan)


def test_unknown_setting_suggests_similar_names() -> None:
    assert refusal(Mapper, resolution=1) == (
        "Mapper has no setting 'resolution'; did you mean 'resolution_m'?"
    )
    assert refusal(Player, zzz=1, file="/") == "Player has no setting 'zzz'; it has file"
    assert refusal(object, zzz=1) == "object has no setting 'zzz'; it has none"


def test_all_errors_are_reported_at_once() -> None:
    assert len(refusal(Mapper, resolution=1, threads=0, verbose=3).splitlines()) == 3


def test_required_setting_must_be_set() -> None:
    assert refusal(Player) == "Player.file: required, but not set (log to play)"


def test_path_that_must_exist_is_checked(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").touch()
    assert check_settings(Player, {"file": "run.mcap"}, folder=tmp_path) == {"file": tmp_path / "run.mcap"}
    with pytest.raises(SettingError, match=rf"there is no {tmp_path}/lost\.mcap$"):
        check_settings(Player, {"file": "lost.mcap"}, folder=tmp_path)
    with pytest.raises(SettingError, match="File name too long"):
        check_settings(Player, {"file": "x" * 5000}, folder=tmp_path)


def test_relative_paths_start_from_the_current_folder_or_the_given_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert check_settings(Mapper, {})["map_file"] == tmp_path / "map.png"
    checked = check_settings(
        Mapper, {"map_file": "a.png"}, folder=Path("/ws"), folder_of={"map_file": Path("/here")}
    )
    assert checked["map_file"] == Path("/here/a.png")


def test_settings_are_inherited_replaced_and_fixed() -> None:
    class Fast(Mapper):
        resolution_m = setting(0.2, "coarser")
        threads = 8
        extra: int = setting(3, "own")

    settings = settings_of(Fast)
    assert next(iter(settings)) == "resolution_m" and list(settings)[-1] == "extra"
    assert check_settings(Fast, {})["resolution_m"] == 0.2
    assert settings["resolution_m"].declared_type is float
    assert refusal(Fast, threads=1).startswith("Fast has no setting 'threads'")
    assert settings_of(Mapper)["resolution_m"].default == 0.05


def test_applied_settings_are_plain_attributes_and_defaults_are_copied() -> None:
    first, second = Mapper(), Mapper()
    apply_settings(first, {"threads": 2})
    apply_settings(second, {})
    assert (first.threads, second.threads) == (2, 1)
    first.offsets_m.append(1.0)
    assert second.offsets_m == [] and Mapper().__class__.offsets_m.default == []  # type: ignore[attr-defined]


def test_applying_wrong_values_changes_nothing() -> None:
    mapper = Mapper()
    with pytest.raises(SettingError):
        apply_settings(mapper, {"threads": 2, "verbose": "no"})
    assert vars(mapper) == {}


def test_reading_a_setting_too_early_is_an_error() -> None:
    with pytest.raises(AttributeError, match=r"Mapper\.threads is read before the settings are applied"):
        _ = Mapper().threads


def test_quoted_annotations_resolve_and_others_are_ignored() -> None:
    class Lazy:
        other: "ExistsForTypeCheckersOnly"  # type: ignore[name-defined]  # noqa: F821
        file: "Optional[Path]" = setting(None, "quoted")  # noqa: UP045

    assert check_settings(Lazy, {"file": "/x"}) == {"file": Path("/x")}


def test_invalid_declaration_is_refused() -> None:
    class Untyped:
        x = setting(1, "no type")

    class Wrong:
        x: complex = setting(1j, "no such value in YAML")

    class Ambiguous:
        x: int | str = setting(1, "which?")

    class BadDefault:
        x: int = setting(0, "outside", minimum=1)

    assert refusal(Untyped) == "Untyped.x needs a type, as in `x: float = setting(…)`"
    assert refusal(BadDefault) == "BadDefault.x: expected int, at least 1; got 0 (int), its default"
    assert "a setting cannot have the type" in refusal(Wrong)
    assert "the only unions are X | None" in refusal(Ambiguous)
