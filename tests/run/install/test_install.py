"""`robbie install` writes a unit that systemd understands, and rules that name devices."""

import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.cli import main
from robbie_mp.cli.new import make_workspace
from robbie_mp.run.install import usb
from robbie_mp.run.install.device_names import DeviceNotNamed, UsbDevice, rules
from robbie_mp.run.install.unit import quoted

LASER = UsbDevice("15d1", "0000", "H1234567", "1-1.2")
CLONE = UsbDevice("1a86", "7523", "", "1-1.3")


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "mouse 100%"
    make_workspace(tmp_path / "mouse")
    (tmp_path / "mouse").rename(folder)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(usb, "serial_devices", dict)
    return folder


def lines_of(text: str, key: str) -> list[str]:
    return [line.partition("=")[2] for line in text.splitlines() if line.startswith(f"{key}=")]


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="no systemd-analyze here")
def test_systemd_finds_no_fault_in_the_unit(workspace: Path, tmp_path: Path) -> None:
    profile = next((workspace / "profiles").iterdir()).stem
    assert main(["install", profile, "--user", "root", "--root", str(tmp_path / "image")]) == 0
    (unit,) = (tmp_path / "image" / "etc/systemd/system").iterdir()
    checked = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True, check=False
    )
    about_it = [line for line in checked.stderr.splitlines() if unit.name in line]
    assert (checked.returncode, about_it) == (0, []), checked.stderr


def test_unit_runs_the_profile_as_the_user_wants(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile = next((workspace / "profiles").iterdir()).stem
    assert main(["install", profile, "--user", "root", "--print"]) == 0
    text = capsys.readouterr().out
    assert lines_of(text, "WorkingDirectory") == [str(workspace).replace("%", "%%")]
    (command,) = lines_of(text, "ExecStart")
    assert command.endswith(f'"run" "{profile}" "--quiet"')
    assert lines_of(text, "Type") == ["notify"]
    assert lines_of(text, "OOMPolicy") == ["continue"]
    assert int(lines_of(text, "LimitNOFILE")[0]) >= 1024


def test_profile_that_could_not_run_is_not_installed(
    workspace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["install", "nonsense", "--print"]) == 2
    assert "nonsense" in capsys.readouterr().err


def test_without_permission_the_error_says_what_to_do(
    workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile = next((workspace / "profiles").iterdir()).stem
    (tmp_path / "file").touch()
    assert main(["install", profile, "--user", "root", "--root", str(tmp_path / "file")]) == 1
    assert "cannot be written" in capsys.readouterr().err
    assert main(["install", profile, "--user", "no such user"]) == 1
    assert "there is no user 'no such user'" in capsys.readouterr().err


def test_device_is_known_by_its_serial_number_or_else_by_its_socket() -> None:
    text = rules({"laser-front": LASER, "base": CLONE}, "dialout").text
    laser, about_base, base = text.splitlines()[1:]
    assert 'ATTRS{serial}=="H1234567"' in laser
    assert laser.endswith('SYMLINK+="robbie/laser-front", GROUP="dialout", MODE="0660"')
    assert "socket 1-1.3" in about_base
    assert 'KERNELS=="1-1.3"' in base


@pytest.mark.parametrize("name", ["", "a b", "../tty", "-x", 'a"b', "é"])
def test_name_that_is_none_of_a_file_is_refused(name: str) -> None:
    with pytest.raises(DeviceNotNamed, match="letters"):
        rules({name: LASER}, "dialout")


def test_one_device_gets_one_name() -> None:
    with pytest.raises(DeviceNotNamed, match="rear and front are the same device"):
        rules({"front": LASER, "rear": LASER}, "dialout")


@given(st.text())
def test_serial_number_cannot_break_a_rule(number: str) -> None:
    text = rules({"laser": UsbDevice("15d1", "0000", number, "1-1")}, "dialout").text
    (rule,) = [line for line in text.split("\n") if line.startswith("SUBSYSTEM")]
    assert rule.count('"') == 14


def test_device_that_is_not_there_is_refused() -> None:
    with pytest.raises(
        DeviceNotNamed, match="no serial device is plugged in at /dev/ttyUSB7; there are: /dev/ttyS0"
    ):
        usb.usb_device("/dev/ttyUSB7", {"/dev/ttyS0": None})
    with pytest.raises(DeviceNotNamed, match="not on USB"):
        usb.usb_device("/dev/ttyS0", {"/dev/ttyS0": None})


@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cc"])))
def test_words_of_a_command_are_quoted(word: str) -> None:
    text = quoted(word)
    assert text[0] == text[-1] == '"'
    inside = text[1:-1].replace("%%", "%").replace("$$", "$").replace('\\"', '"').replace("\\\\", "\\")
    assert "\\" in word or inside == word


def test_control_characters_in_words_are_escaped() -> None:
    assert quoted("a\x1b\n\x7fb") == r'"a\x1b\x0a\x7fb"'


def test_devices_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices"]) == 0
    assert capsys.readouterr().out
