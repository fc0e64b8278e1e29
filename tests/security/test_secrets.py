"""Only its module knows a secret setting; it appears nowhere else."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest

from robbie_mp import REQUIRED, Secret, SettingError, setting
from robbie_mp.module.secret import MAX_SECRET_BYTES
from robbie_mp.module.settings import check_settings
from tests._support.robot import Ended, Robot

SECRET = "correct-horse-battery-staple"
HERE = Path(__file__).parent
PROFILE = """
modules:
  keeper:
    class: zoo.secrets:Keeper
    checkpoint: {persist: true, persist_every_s: 0.0}
    settings: {key: "file:keeper.secret"}
  logger: {class: "robbie_mp.logs.message_logger:MessageLogger", settings: {folder: logs}}
"""


class Holder:
    key: Secret = setting(REQUIRED, "a secret")
    keys: list[Secret] = setting([], "more of them")
    maybe: Secret | None = setting(None, "perhaps one")


@pytest.fixture
def keeper(robot: Robot) -> Robot:
    (robot.folder / "zoo" / "secrets.py").write_text((HERE / "_support" / "secret_modules.py").read_text())
    robot.write_secret("keeper.secret", SECRET)
    robot.write_profile(PROFILE)
    return robot


def files_with_secret(*folders: Path) -> list[Path]:
    files = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    assert files
    return [path for path in files if SECRET.encode() in path.read_bytes()]


def command_lines() -> list[bytes]:
    found = []
    for process in Path("/proc").iterdir():
        try:
            found.append((process / "cmdline").read_bytes())
        except OSError:
            continue
    return found


@pytest.mark.slow
def test_secret_reaches_its_module_and_appears_in_no_file_or_output(keeper: Robot) -> None:
    process = keeper.start()
    keeper.until(lambda modules: modules["keeper"]["restarts"] == 1 and modules["keeper"]["ticks"] > 3)
    run = keeper.known_run()
    assert not any(SECRET.encode() in line for line in command_lines())
    said = [
        keeper.command("profile", "show", "robot"),
        keeper.command("profile", "show", "robot", "--json"),
        keeper.command("param", "list", "--run", run.run_id),
        keeper.command("log", "--run", run.run_id),
    ]
    found = files_with_secret(run.folder)
    ended = Ended.in_order(process)
    place = keeper.folder / "keeper.secret"
    assert f"file:{place}" in said[0].stdout
    said_texts = [text for result in said for text in (result.stdout, result.stderr)]
    assert not any(SECRET in text for text in [*said_texts, ended.stderr])
    assert (keeper.output / "hash.txt").read_text() == hashlib.sha256(SECRET.encode()).hexdigest()
    assert list((keeper.folder / "logs").rglob("*.mcap"))
    assert list(keeper.output.rglob("crashes/*.json"))
    assert [*found, *files_with_secret(keeper.folder)] == [place]


@pytest.mark.parametrize("value", [SECRET, f"[{SECRET}]", f"{{file: {SECRET}}}", f"env:{SECRET}"])
@pytest.mark.parametrize("command", ["run", "profile show"])
def test_secret_in_clear_text_is_refused_and_not_repeated(keeper: Robot, command: str, value: str) -> None:
    refused = keeper.command(*command.split(), "robot", "--set", f"keeper.key={value}")
    assert refused.returncode == 2
    assert "--set keeper.key: modules.keeper.settings: Keeper.key: expected where the secret is kept, as" in (
        refused.stderr
    )
    assert "file:PATH or environment:NAME" in refused.stderr
    assert SECRET not in refused.stdout + refused.stderr
    assert "Traceback" not in refused.stderr


@pytest.mark.slow
def test_secret_in_clear_text_in_a_profile_is_refused_and_not_repeated(keeper: Robot) -> None:
    keeper.write_profile(PROFILE.replace("file:keeper.secret", SECRET))
    refused = keeper.command("run", "robot")
    assert refused.returncode == 2
    assert "robot.yaml:6: modules.keeper.settings: Keeper.key: expected where the secret" in refused.stderr
    assert SECRET not in refused.stderr


def test_secret_is_read_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBBIE_TEST_KEY", SECRET)
    found: Any = check_settings(Holder, {"key": "environment:ROBBIE_TEST_KEY"})
    assert found["key"].reveal() == SECRET
    assert (str(found["key"]), repr(found["key"])) == (
        "environment:ROBBIE_TEST_KEY",
        "Secret(environment:ROBBIE_TEST_KEY)",
    )
    assert SECRET not in json.dumps(found, default=str)


def test_secret_is_read_from_a_file_and_again_from_its_shown_place(tmp_path: Path) -> None:
    (tmp_path / "key").touch(0o600)
    (tmp_path / "key").write_text(f"{SECRET}\n")
    found: Any = check_settings(Holder, {"key": "file:key"}, folder=tmp_path)
    assert found["key"].reveal() == SECRET
    again: Any = check_settings(Holder, json.loads(json.dumps(found, default=str)))
    assert again["key"].reveal() == SECRET


def refusal(values: dict[str, object], folder: Path | None = None) -> str:
    with pytest.raises(SettingError) as caught:
        check_settings(Holder, values, folder=folder)
    assert SECRET not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("value", [SECRET, {SECRET: SECRET}, [SECRET], 17, "file:", "environment:", None])
def test_invalid_place_of_a_secret_is_refused(value: object) -> None:
    assert "Holder.key: expected where the secret is kept" in refusal({"key": value})


def test_list_of_secrets_in_clear_text_is_not_repeated() -> None:
    assert "Holder.keys: expected list of secret" in refusal({"key": Secret("x"), "keys": SECRET})
    assert "Holder.keys: element 0" in refusal({"key": Secret("x"), "keys": [SECRET]})


def test_variable_that_is_not_set_is_reported_by_name() -> None:
    assert "no variable ROBBIE_NOT_SET" in refusal({"key": "environment:ROBBIE_NOT_SET"})


def test_unsuitable_file_of_a_secret_is_refused_with_the_reason(tmp_path: Path) -> None:
    key = tmp_path / "key"
    assert "No such file" in refusal({"key": "file:key"}, tmp_path)
    assert "is not a regular file" in refusal({"key": "file:."}, tmp_path)
    os.mkfifo(key)  # opening one would wait for ever
    assert "is not a regular file" in refusal({"key": "file:key"}, tmp_path)
    key.unlink()
    key.touch(0o600)
    assert "is empty" in refusal({"key": "file:key"}, tmp_path)
    key.write_text(SECRET)
    for mode in (0o640, 0o604, 0o644):
        key.chmod(mode)
        assert "chmod 600" in refusal({"key": "file:key"}, tmp_path)
    key.chmod(0o600)
    key.write_bytes(b"\xff\xfe")
    assert "is not UTF-8 text" in refusal({"key": "file:key"}, tmp_path)
    key.write_text("x" * (MAX_SECRET_BYTES + 1))
    assert "longer than 4096 bytes" in refusal({"key": "file:key"}, tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="ANOTHER USER'S SECRET FILE IS NOT TESTED: that takes root")
def test_file_of_another_user_is_refused(tmp_path: Path) -> None:
    (tmp_path / "key").touch(0o600)
    os.chown(tmp_path / "key", 65534, 65534)
    assert "belongs to user 65534" in refusal({"key": "file:key"}, tmp_path)


def test_secret_cannot_be_declared_changeable() -> None:
    class Wrong:
        key: Secret | None = setting(None, "it would be sent around", changeable=True)

    with pytest.raises(SettingError, match="a secret cannot be changeable"):
        check_settings(Wrong, {})
