"""How `robbie play` translates its options."""

import math
from argparse import ArgumentTypeError
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.cli.play import _alone, _settings, gaps, rate
from robbie_mp.cli.program import parser_of
from robbie_mp.logs.playback.module import Playback
from robbie_mp.logs.recording.time_jumps import LONGEST_GAP_S
from robbie_mp.module.settings import check_settings
from robbie_mp.run.profile.load import load_profile
from tests.logs._support.battery_log import write_battery_log

PROJECT = Path(__file__).parents[2]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_battery_log(tmp_path / "log.mcap", 5)


def test_options_are_settings_of_the_playback(log: Path) -> None:
    words = ["--rate", "max", "--start", "0.1", "--end", "0.3", "--loop", "--paused"]
    words += ["--topics", "battery", "DriveCommand", "--gaps", "keep", "--strict"]
    arguments = parser_of(["play"]).parse_args(["play", str(log), "demo-playback", *words])
    settings = check_settings(Playback, _settings(arguments))
    Playback.check(settings)
    given = ("file", "rate", "start_s", "end_s", "loop", "paused", "topics", "longest_gap_s", "strict")
    assert [settings[name] for name in given] == [
        log, None, 0.1, 0.3, True, True, ["battery", "DriveCommand"], None, True,
    ]  # fmt: skip


def test_options_not_given_keep_the_profiles_values_or_real_time(log: Path) -> None:
    settings = _settings(parser_of(["play"]).parse_args(["play", str(log)]))
    assert settings == {"file": str(log)}
    alone = _alone(settings)
    assert alone.modules[0].settings["rate"] == 1.0
    assert alone.clock.source == alone.modules[0].name


@pytest.mark.slow
@pytest.mark.parametrize("profile", [[], ["demo-playback"]])
def test_errors_name_what_was_typed(
    profile: list[str],
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(PROJECT)
    bad = tmp_path / "bad.mcap"
    bad.write_text("no log at all")
    assert main(["play", str(bad), *profile]) == 2
    assert capsys.readouterr().err == f"{bad} is no MCAP file\n"
    assert main(["play", str(log), *profile, "--start", "-1"]) == 2
    assert "--set" not in (error := capsys.readouterr().err)
    assert "start_s" in error
    if profile:
        assert main(["play", str(log), *profile, "--set", f"playback.file={bad}"]) == 2
        assert capsys.readouterr().err == f"--set playback.file: {bad} is no MCAP file\n"


def test_gaps_are_the_longest_that_are_no_jump() -> None:
    assert [gaps(text) for text in ("skip", "keep", "30")] == [LONGEST_GAP_S, math.inf, 30]
    for text in ("-1", "nan", "never"):
        with pytest.raises((ValueError, ArgumentTypeError)):
            gaps(text)


@pytest.mark.parametrize("text", ["0", "-1", "nan"])
def test_impossible_rates_are_refused(text: str) -> None:
    with pytest.raises(Exception, match="greater than 0, or max"):
        rate(text)
    assert rate("max") == math.inf


@pytest.mark.parametrize("profile", ["demo-playback", "mapping-playback"])
def test_stock_playback_profiles_have_a_playback_that_controls_the_clock(profile: str) -> None:
    loaded = load_profile(profile, PROJECT)
    names = [module.name for module in loaded.modules]
    assert sorted(names) == ["mapping", "playback"]
    assert loaded.clock.source == "playback"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--charge", "measured"], "--charge works only with --lockstep"),
        (["--charge", "nowhere", "--lockstep"], "nowhere has no handler times"),
    ],
)
def test_charge_that_is_impossible_is_refused(
    log: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", str(log), *words]) == 2
    assert said in capsys.readouterr().err
