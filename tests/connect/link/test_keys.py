"""A few commands make and exchange keys. Only robots that trust each other connect, over Zenoh's TLS."""

import json
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.connect.link.handshake import NotConnected, shake_hands
from robbie_mp.connect.link.keys import Keys, KeysError

PEER = Path(__file__).parent / "_support" / "tls_peer.py"
LIMIT_S = 30.0


@pytest.fixture
def robot(tmp_path: Path) -> Keys:
    return made(tmp_path / "robot", "robot_1")


@pytest.fixture
def laptop(tmp_path: Path) -> Keys:
    return made(tmp_path / "laptop", "laptop")


def made(folder: Path, name: str) -> Keys:
    keys = Keys(folder)
    keys.make(name)
    return keys


def made_expired(folder: Path, name: str) -> Keys:
    keys = Keys(folder)
    keys._make(name, datetime.now(timezone.utc) - timedelta(days=1))
    return keys


def trust_each_other(one: Keys, other: Keys) -> None:
    one.trust(other.own().file)
    other.trust(one.own().file)


def trust_before_it_expired(keys: Keys, late: Keys) -> None:
    (keys.folder / "trusted").mkdir(mode=0o700, exist_ok=True)
    (keys.folder / "trusted" / "late.pem").write_bytes(late.own().file.read_bytes())


def valid(keys: Keys) -> dict[str, str]:
    """Return settings of Zenoh as JSON5."""
    return {path: json.dumps(value) for path, value in keys.zenoh_settings().items()}


def of_folder(keys: Keys, settings: dict[str, str]) -> dict[str, str]:
    """Return settings that use the files of these keys, even if they have expired."""
    folder = Path(json.loads(settings["transport/link/tls/connect_certificate"])).parent
    return {key: value.replace(str(folder), str(keys.folder)) for key, value in settings.items()}


def peer(role: str, port: int, settings: dict[str, str]) -> list[str]:
    return [sys.executable, str(PEER), role, str(port), json.dumps(settings)]


@contextmanager
def listening(settings: dict[str, str]) -> Iterator[int]:
    """Run a session of Zenoh that answers what it hears; yield its port."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    command = peer("listen", port, settings)
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    try:
        yield port
    finally:
        process.communicate()


def answer(settings: dict[str, str], port: int) -> str:
    """Ask the listener with another session of Zenoh; return its answer, or "refused"."""
    command = peer("ask", port, settings)
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=LIMIT_S).stdout.strip()


def test_two_robots_that_trust_each_other_exchange_messages(robot: Keys, laptop: Keys) -> None:
    trust_each_other(robot, laptop)
    with listening(valid(robot)) as port:
        assert answer(valid(laptop), port) == "hello, too"
        assert shake_hands(laptop, "127.0.0.1", port) == "robot_1"


def test_untrusted_missing_and_expired_certificates_are_refused_and_we_say_why(
    robot: Keys, laptop: Keys, tmp_path: Path
) -> None:
    trust_each_other(robot, laptop)
    stranger = made(tmp_path / "stranger", "stranger")
    stranger.trust(robot.own().file)
    doubting = made(tmp_path / "doubting", "doubting")
    robot.trust(doubting.own().file)
    late = made_expired(tmp_path / "late", "late")
    with pytest.raises(KeysError, match="expired on"):
        robot.trust(late.own().file)
    trust_before_it_expired(robot, late)
    late.trust(robot.own().file)
    without = valid(laptop) | {
        "transport/link/tls/connect_private_key": "null",
        "transport/link/tls/connect_certificate": "null",
        "transport/link/tls/enable_mtls": "false",
    }
    expired = of_folder(late, valid(laptop))
    with listening(valid(robot)) as port:
        for settings in (without, expired, valid(stranger), valid(doubting)):
            assert answer(settings, port) == "refused"
        with pytest.raises(NotConnected, match=r"does not trust this robot; copy .*stranger\.pem there"):
            shake_hands(stranger, "127.0.0.1", port)
        with pytest.raises(NotConnected, match=r"it is not trusted here; copy its NAME\.pem"):
            shake_hands(doubting, "127.0.0.1", port)
        with pytest.raises(KeysError, match=r"expired on .*robbie keys new late --replace"):
            shake_hands(late, "127.0.0.1", port)
        assert answer(valid(laptop), port) == "hello, too"


def test_revoked_robot_is_refused_by_the_next_link(robot: Keys, laptop: Keys) -> None:
    trust_each_other(robot, laptop)
    robot.revoke("laptop")
    with listening(valid(robot)) as port:
        assert answer(valid(laptop), port) == "refused"


def test_robot_with_an_expired_certificate_is_refused_and_we_say_why(laptop: Keys, tmp_path: Path) -> None:
    late = made_expired(tmp_path / "late", "late")
    late.trust(laptop.own().file)
    trust_before_it_expired(laptop, late)
    with listening(of_folder(late, valid(laptop))) as port:
        assert answer(valid(laptop), port) == "refused"
        with pytest.raises(NotConnected, match="its certificate has expired; make a new one there"):
            shake_hands(laptop, "127.0.0.1", port)


def test_what_does_not_answer_or_speaks_no_tls_is_told(laptop: Keys) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(NotConnected, match=f"127.0.0.1:{port}: no robot answers there: Connection refused"):
        shake_hands(laptop, "127.0.0.1", port)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer_in_clear() -> None:
            with server.accept()[0] as connection:
                connection.recv(1000)
                connection.sendall(b"220 mail.example.org\r\n")

        thread = threading.Thread(target=answer_in_clear)
        thread.start()
        with pytest.raises(NotConnected, match="does not speak TLS"):
            shake_hands(laptop, "127.0.0.1", server.getsockname()[1])
        thread.join()


def test_private_files_are_private(robot: Keys, laptop: Keys) -> None:
    trust_each_other(robot, laptop)
    for file in robot.folder.rglob("*"):
        mode = stat.S_IMODE(file.stat().st_mode)
        assert mode == (0o700 if file.is_dir() else 0o600), file
    assert "PRIVATE" not in robot.own().file.read_text()


@pytest.mark.parametrize("name", [".", "own.key"])
def test_keys_that_others_can_read_are_not_used(robot: Keys, name: str) -> None:
    (robot.folder / name).chmod(0o755)
    with pytest.raises(KeysError, match=r"mode 0755, others must have no access .*pretend to be robot_1"):
        robot.zenoh_settings()


def test_keys_are_not_replaced_by_mistake(robot: Keys) -> None:
    before = robot.own()
    with pytest.raises(KeysError, match=r"there are keys in .* robbie keys new --replace"):
        robot.make("robot_1")
    assert robot.own() == before
    after = robot.make("robot_2", replace=True)
    assert after.robot == "robot_2"
    assert after.fingerprint != before.fingerprint
    assert not before.file.exists()


def test_new_keys_of_a_trusted_name_need_a_revocation(robot: Keys, laptop: Keys) -> None:
    robot.trust(laptop.own().file)
    laptop.make("laptop", replace=True)
    with pytest.raises(KeysError, match=r"a robot laptop with another key .* robbie keys revoke laptop"):
        robot.trust(laptop.own().file)
    robot.revoke("laptop")
    robot.trust(laptop.own().file)
    robot.trust(laptop.own().file)  # once more changes nothing
    assert [one.fingerprint for one in robot.trusted()] == [laptop.own().fingerprint]


def test_wrong_files_are_refused_with_what_is_wrong(robot: Keys, laptop: Keys, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.pem"
    for content, expected in (
        ((laptop.folder / "own.key").read_bytes(), "private key, which nobody else may have"),
        ((laptop.folder / "own.pem").read_bytes(), "no certificate that `robbie keys new` made"),
        (laptop.own().file.read_bytes() * 2, "no certificate that `robbie keys new` made"),
        (b"\xff\x00 nonsense", "no certificate in PEM"),
        (b"", "no certificate in PEM"),
        (b"x" * 20_000, "more than 16384 bytes"),
        (robot.own().file.read_bytes(), "is of robot_1, as this robot is called, too"),
    ):
        wrong.write_bytes(content)
        with pytest.raises(KeysError, match=expected):
            robot.trust(wrong)
    with pytest.raises(KeysError, match=r"cannot read .*none\.pem: No such file"):
        robot.trust(tmp_path / "none.pem")
    assert robot.trusted() == []


def test_names_and_times_that_cannot_be_are_refused(tmp_path: Path) -> None:
    keys = Keys(tmp_path / "keys")
    for name in ("", "../up", "a b", "x" * 33):
        with pytest.raises(KeysError, match="a robot's name has"):
            keys.make(name)
    for days in (0, -1, float("nan"), 1e9):
        with pytest.raises(KeysError, match="keys are valid for"):
            keys.make("robot", days)
    assert not keys.folder.exists()
    with pytest.raises(KeysError, match=r"there are no keys in .*: robbie keys new NAME"):
        keys.zenoh_settings()
    (tmp_path / "file").touch()
    with pytest.raises(KeysError, match="cannot write "):
        Keys(tmp_path / "file" / "keys").make("robot")


def test_commands_make_exchange_list_and_revoke(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def robbie(*words: str, code: int = 0) -> str:
        assert main(["keys", *words[1:], "--folder", str(tmp_path / words[0])]) == code
        printed = capsys.readouterr()
        return printed.out if code == 0 else printed.err

    told = robbie("robot", "new", "robot1")
    public = tmp_path / "robot" / "robot1.pem"
    assert f"copy {public} to each robot" in told
    robbie("laptop", "new", "laptop")
    fingerprint = Keys(tmp_path / "robot").own().fingerprint
    assert fingerprint in told
    assert fingerprint in robbie("laptop", "trust", str(public))
    listed = json.loads(robbie("laptop", "list", "--json"))
    assert listed["own"]["robot"] == "laptop"
    assert [one["fingerprint"] for one in listed["trusted"]] == [fingerprint]
    assert fingerprint in robbie("laptop", "list")
    assert "'robot' is not trusted; did you mean 'robot1'?" in robbie("laptop", "revoke", "robot", code=1)
    robbie("laptop", "revoke", "robot1")
    assert json.loads(robbie("laptop", "list", "--json"))["trusted"] == []
    assert "expected HOST:PORT" in robbie("laptop", "check", "robot1", code=1)
    assert "made the keys of robot1" in robbie("robot", "new", "--replace")
