"""Problems of a log, or of playing it into a robot, are reported before anything starts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from robbie_mp import Message, SettingError, Upgrade, float32
from robbie_mp.logs.playback.module import Playback
from robbie_mp.module.settings import check_settings
from tests.logs._support.battery_log import write_battery_log
from tests.logs.recording._support.logs import START_NS, LogFile

LENGTH_S = 1.9


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_battery_log(tmp_path_factory.mktemp("logs") / "log.mcap", 20)


def settings_for(file: Path, **given: object) -> dict[str, Any]:
    return check_settings(Playback, {"file": str(file), **given})


@pytest.mark.parametrize(
    ("given", "setting", "said"),
    [
        ({"start_s": 2.0}, "start_s", f"has only {LENGTH_S:g} s"),
        ({"start_s": 1.0, "end_s": 0.5}, "end_s", "before start_s"),
        (
            {"topics": ["odom", "/camera/*"]},
            "topics",
            r"no channel that matches odom, /camera/\*; it has DriveCommand",
        ),
    ],
)
def test_settings_that_do_not_fit_the_log_are_refused(
    log: Path, given: dict[str, object], setting: str, said: str
) -> None:
    with pytest.raises(SettingError, match=said) as refusal:
        Playback.check(settings_for(log, **given))
    assert refusal.value.setting == setting


@pytest.mark.parametrize("content", [b"", b"hello, I am text", b"SQLite format 3\0" + bytes(100)])
def test_file_that_is_not_a_log_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "file"
    file.write_bytes(content)
    with pytest.raises(SettingError, match=str(file)):
        Playback.check(settings_for(file))


def test_cut_log_is_played(tmp_path: Path, log: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:2500])
    Playback.check(settings_for(cut))


@pytest.mark.parametrize(("topic", "fits"), [("/battery", True), ("DriveCommand", True), ("Battery", False)])
def test_pattern_is_compared_with_the_topic_or_without_one_with_the_type(
    log: Path, topic: str, fits: bool
) -> None:
    settings = settings_for(log, topics=[topic])
    if fits:
        Playback.check(settings)
    else:
        with pytest.raises(SettingError):
            Playback.check(settings)


def further(file: Path, others: Sequence[str] = (), **given: object) -> list[str]:
    return [one.name for one in Playback.further_types(settings_for(file, **given), others)]


class Gauge(Message, name="made_msgs/msg/Gauge", version=3, upgrades={2: Upgrade(dict)}):
    ratio: float32


def gauge_log(path: Path, version: int, schema: str) -> Path:
    with LogFile(path) as log:
        channel = log.channel(Gauge.type_name, schema, version, "gauge", "power")
        log.add_bytes(channel, b"\0\1\0\0\0\0\0\0", START_NS)
    return path


@pytest.mark.parametrize(
    ("version", "said"),
    [
        (1, "made_msgs/msg/Gauge: version 1 cannot become 3: the step from 1 to 2 is missing"),
        (4, "made_msgs/msg/Gauge: version 4 was written, 3 is the newest here"),
        (3, "version 3 has other fields"),
    ],
)
def test_version_that_cannot_be_upgraded_is_refused_if_it_is_played(
    tmp_path: Path, version: int, said: str
) -> None:
    log = gauge_log(tmp_path / "log.mcap", version, "float32 percent")
    with pytest.raises(SettingError, match=said):
        further(log)
    assert further(log, others=["power"]) == []
    with pytest.raises(SettingError, match=said):
        further(log, others=["power"], senders=["pow*"])


@pytest.mark.parametrize(("version", "schema"), [(2, "float32 percent"), (3, "float32   ratio # of 1")])
def test_version_that_can_be_upgraded_is_accepted(tmp_path: Path, version: int, schema: str) -> None:
    assert further(gauge_log(tmp_path / "log.mcap", version, schema)) == []


def test_undeclared_types_are_described_for_tools(log: Path) -> None:
    assert sorted(further(log)) == ["other_msgs/msg/Stranger", "played_msgs/msg/Battery"]
    assert further(log, others=["power"]) == []
