"""Bags of ROS 2 are read whatever their metadata says; what is left out is counted, nothing else lost."""

import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
import zstandard
from rosbags.typesys import Stores, get_typestore

from robbie_mp.base.balance import Balance, LeftOut
from robbie_mp.cli import main
from robbie_mp.logs.recording.decoding import LogDecoder
from robbie_mp.logs.recording.errors import BagUnreadable
from robbie_mp.logs.recording.reader import Log, open_log
from robbie_mp.logs.recording.repair import unwatched
from robbie_mp.logs.recording.rosbag_import import import_rosbag
from robbie_mp.messages.service_events import event_schema
from tests.logs.recording._support.logs import START_NS
from tests.logs.recording._support.ros2_bags import (
    LATCHED,
    Topic,
    metadata,
    rows,
    text,
    write_bag,
    write_mcap,
    write_sqlite,
)

STORAGES = ["mcap", "sqlite3"]
CHAT, NEWS = Topic("/chat"), Topic("/news", durability=LATCHED)
ADD = """\
================================================================================
SRV: example_interfaces/srv/AddTwoInts
int64 a
int64 b
---
int64 sum
"""
ADD_EVENT = Topic("/add/_service_event", "example_interfaces/srv/AddTwoInts_Event", ADD, "unknown")
EVENT_HEAD = b"\0\1\0\0" + bytes([1, 0, 0, 0]) + (5).to_bytes(4, "little") + (6).to_bytes(4, "little")
REQUEST = EVENT_HEAD + bytes(range(16)) + bytes(4) + (7).to_bytes(8, "little")
REQUEST += (
    (1).to_bytes(4, "little") + bytes(4) + b"".join(n.to_bytes(8, "little") for n in (30, 12)) + bytes(4)
)
IDL = """\
================================================================================
IDL: team_msgs/msg/Level
module team_msgs { module msg { struct Level { string data; }; }; };
"""


def imported(bag: Path, balance: Balance | None = None) -> tuple[list[str], Balance, list[str]]:
    """Import a bag; return the texts in it, the balance, and the notes."""
    balance = balance or Balance()
    target = bag.parent / "imported.mcap"
    target.unlink(missing_ok=True)
    notes = import_rosbag(bag, target, balance, progress=unwatched)
    with open_log(target) as log:
        decoder = LogDecoder()
        found = [decoder.decode(message) for message in log.messages()]
        assert len(found) == balance.used
        return [getattr(one, "data", "") for one in found], balance, notes


def numbers(count: int = 20) -> list[str]:
    return [f"{n}" for n in range(count)]


def change(bag: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    path = bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    edit(content["rosbag2_bagfile_information"])
    path.write_text(yaml.safe_dump(content))


def two_parts(folder: Path, storage: str, **options: Any) -> Path:
    messages = rows([CHAT, NEWS])
    return write_bag(folder, [messages[:12], messages[12:]], storage, **options)


@pytest.mark.parametrize("storage", STORAGES)
def test_topic_with_another_quality_of_service_in_the_metadata_is_read(tmp_path: Path, storage: str) -> None:
    bag = two_parts(tmp_path / "bag", storage)

    def disagree(about: dict[str, Any]) -> None:
        for topic in about["topics_with_message_count"]:
            topic["topic_metadata"]["offered_qos_profiles"][0]["depth"] = 99

    change(bag, disagree)
    texts, balance, notes = imported(bag)
    assert (texts, balance.left_out, notes) == (numbers(), {}, [])


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("version", range(1, 10))
def test_every_version_of_the_metadata_is_read(tmp_path: Path, storage: str, version: int) -> None:
    bag = two_parts(
        tmp_path / "bag", storage, version=version, schema=(version + 1) // 2 if version < 8 else 4
    )
    texts, balance, notes = imported(bag)
    assert (texts, balance.left_out, notes) == (numbers(), {}, [])
    with open_log(tmp_path / "imported.mcap") as log:
        latched = {channel.topic for channel in log.channels if channel.is_latched}
    assert latched == ({"news"} if storage == "mcap" or version >= 3 else set())


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(
    "content",
    [None, "", "[", "3", "rosbag2_bagfile_information: 3", "\x00", "!!int ''", "!!timestamp ''", "[" * 500],
)
def test_bag_without_readable_metadata_is_read(tmp_path: Path, storage: str, content: str | None) -> None:
    bag = two_parts(tmp_path / "bag", storage)
    (bag / "metadata.yaml").unlink()
    if content is not None:
        (bag / "metadata.yaml").write_text(content)
    texts, balance, notes = imported(bag)
    assert (texts, balance.left_out) == (numbers(), {})
    assert len(notes) == 1 and "metadata.yaml" in notes[0]


@pytest.mark.parametrize("storage", STORAGES)
def test_metadata_that_lists_less_than_there_is_hides_nothing(tmp_path: Path, storage: str) -> None:
    bag = two_parts(tmp_path / "bag", storage)

    def forget(about: dict[str, Any]) -> None:
        about["relative_file_paths"].pop()
        about["topics_with_message_count"].pop()

    change(bag, forget)
    texts, balance, notes = imported(bag)
    assert (texts, balance.left_out) == (numbers(), {})
    assert "is not in metadata.yaml, but a part of the bag" in notes[0]
    assert notes[1:] == ["metadata.yaml counts 0 messages of /news, the files hold 10"]


@pytest.mark.parametrize("storage", STORAGES)
def test_metadata_that_lists_more_than_there_is_is_said(tmp_path: Path, storage: str) -> None:
    bag = two_parts(tmp_path / "bag", storage)

    def invent(about: dict[str, Any]) -> None:
        about["relative_file_paths"].append("bag_2.mcap")
        about["files"].append({"path": "bag_2.mcap", "message_count": 7})
        row = about["topics_with_message_count"][0]
        about["topics_with_message_count"].append(
            {"topic_metadata": row["topic_metadata"] | {"name": "/more"}, "message_count": 7}
        )

    change(bag, invent)
    texts, balance, notes = imported(bag)
    assert texts == numbers() and notes == ["metadata.yaml counts 7 messages of /more, the files hold 0"]
    ((reason, count),) = balance.left_out.items()
    assert "bag_2.mcap" in reason and "does not exist" in reason and count == 7


@pytest.mark.parametrize("seed", range(20))
def test_no_change_of_the_metadata_loses_a_message(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    bag = two_parts(tmp_path / "bag", chance.choice(STORAGES))

    def damage(value: Any) -> Any:
        if chance.random() < 0.1:
            return chance.choice([None, 3, -1, "", "x", [], {}, True, 1e300])
        if isinstance(value, dict):
            return {key: damage(one) for key, one in value.items() if chance.random() < 0.9}
        return [damage(one) for one in value] if isinstance(value, list) else value

    path = bag / "metadata.yaml"
    path.write_text(yaml.safe_dump(damage(yaml.safe_load(path.read_text()))))
    texts, balance, _ = imported(bag)
    assert texts == numbers() and balance.used == 20


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("form", ["unknown", "ros2msg", "of the event"])
def test_service_events_are_kept_beside_the_other_topics(tmp_path: Path, storage: str, form: str) -> None:
    definition = event_schema(ADD_EVENT.type_name, ADD) if form == "of the event" else ADD
    topic = ADD_EVENT._replace(definition=definition, form="unknown" if form == "unknown" else "ros2msg")
    bag = write_bag(tmp_path / "bag", [[*rows([CHAT], 3), (topic, START_NS + 5, REQUEST)]], storage)
    texts, balance, _ = imported(bag)
    assert texts[:3] == numbers(3) and (balance.used, balance.left_out) == (4, {})
    with open_log(tmp_path / "imported.mcap") as log:
        *_, message = log.messages()
        event: Any = LogDecoder().decode(message)
    assert message.channel.type_name == "example_interfaces/srv/AddTwoInts_Event"
    assert (event.info.event_type, event.info.stamp.sec, event.info.sequence_number) == (1, 5, 7)
    assert event.info.client_gid.tolist() == list(range(16))
    assert [(one.a, one.b) for one in event.request] == [(30, 12)] and event.response == []


def test_service_events_of_a_bag_are_shown_and_exported(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [[(ADD_EVENT, START_NS, REQUEST)]], "mcap")
    assert main(["export", str(bag), str(tmp_path / "out")]) == 0
    (table,) = (tmp_path / "out").iterdir()
    assert ",1,5,6," in table.read_text() and "30" in table.read_text()
    assert main(["export", str(bag), str(tmp_path / "again"), "--rosbag2"]) == 0
    assert main(["diff", str(bag), str(tmp_path / "again")]) == 0


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(
    "broken",
    [
        Topic("/bad", "team_msgs/msg/Unknown", None, ""),
        Topic("/bad", "team_msgs/msg/Unknown", "module {", "ros2idl"),
        Topic("/bad", "team_msgs/srv/Do_Event", "int64 a", "unknown"),
        Topic("/bad", "team_msgs/srv/Do_Event", "", "unknown"),
        Topic("/bad", "team_msgs/srv/Do_Event", "", "ros2msg"),
        Topic("/bad", encoding="cbor"),
    ],
)
def test_topic_that_cannot_be_read_leaves_out_only_itself(
    tmp_path: Path, storage: str, broken: Topic
) -> None:
    messages = rows([CHAT, broken])
    bag = write_bag(tmp_path / "bag", [messages], storage)
    texts, balance, _ = imported(bag)
    assert texts == [f"{n}" for n in range(0, 20, 2)]
    ((reason, count),) = balance.left_out.items()
    assert reason.startswith("messages of /bad, whose ") and count == 10 and balance.read == 20
    with pytest.raises(LeftOut):
        imported(bag, Balance(is_strict=True))
    assert not (tmp_path / "imported.mcap").exists()


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(
    "topic",
    [
        Topic("/t", "team_msgs/msg/Level", IDL, "ros2idl"),
        Topic("/t", "team_msgs/msg/Level", IDL.partition("Level\n")[2], "omgidl"),
        Topic("/t", "team_msgs/msg/Level", "string data  # with a comment\nint32 MORE=3"),
        Topic("/t", "std_msgs/msg/String", None, ""),
        Topic("/t", "std_msgs/msg/String", "", "ros2msg"),
    ],
)
def test_definition_of_every_form_is_understood(tmp_path: Path, storage: str, topic: Topic) -> None:
    assert imported(write_bag(tmp_path / "bag", [rows([topic], 4)], storage))[0] == numbers(4)


@pytest.mark.parametrize("storage", STORAGES)
def test_type_without_fields_keeps_its_messages(tmp_path: Path, storage: str) -> None:
    topic = Topic("/go", "team_msgs/msg/Go", "")
    bag = write_bag(tmp_path / "bag", [[(topic, START_NS + n, b"\0\1\0\0\0") for n in range(3)]], storage)
    assert imported(bag)[1].used == 3


def test_types_of_a_bag_without_definitions_are_those_of_its_distribution(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS2_FOXY)
    kind = "sensor_msgs/msg/Range"
    message = types.types[kind]
    header = types.types["std_msgs/msg/Header"](types.types["builtin_interfaces/msg/Time"](1, 2), "a")
    data = bytes(types.serialize_cdr(message(header, 0, 1.0, 2.0, 3.0, 4.0), kind))
    topic = Topic("/range", kind, None, "")
    bag = write_bag(tmp_path / "bag", [[(topic, START_NS, data)]], "sqlite3", 4, schema=2)
    change(bag, lambda about: about.update(ros_distro="foxy"))
    imported(bag)
    with open_log(tmp_path / "imported.mcap") as log:
        (decoded,) = map(LogDecoder().decode, log.messages())
    assert decoded.range == 4.0  # type: ignore[attr-defined]


def test_messages_of_every_encoding_are_read_or_counted(tmp_path: Path) -> None:
    big = b"\0\0\0\0" + (2).to_bytes(4, "big") + b"x\0"
    odd = [b"\0\7\0\0" + big[4:], b"\0\3\0\0", b"", b"\0", b"\0\0\0\0\xff\xff\xff\xff"]
    times = range(START_NS, START_NS + 7)
    messages = [(CHAT, time_ns, data) for time_ns, data in zip(times, [text("y"), big, *odd], strict=True)]
    texts, balance, _ = imported(write_bag(tmp_path / "bag", [messages], "sqlite3"))
    assert texts == ["y", "x"] and balance.read == 7


@pytest.mark.parametrize("storage", STORAGES)
def test_compressed_bag_is_read(tmp_path: Path, storage: str) -> None:
    compress = zstandard.ZstdCompressor().compress
    messages = [(topic, time_ns, compress(data)) for topic, time_ns, data in rows([CHAT, NEWS])]
    messages.append((CHAT, START_NS + 99, b"\x28\xb5\x2f\xfd damaged"))
    texts, balance, _ = imported(write_bag(tmp_path / "bag", [messages], storage))
    assert texts == numbers() and balance.left_out == {"messages of /chat that cannot be decompressed": 1}


@pytest.mark.parametrize("storage", STORAGES)
def test_bag_of_compressed_files_is_read(tmp_path: Path, storage: str) -> None:
    bag = two_parts(tmp_path / "bag", storage)
    for file in [one for one in bag.iterdir() if one.suffix != ".yaml"]:
        file.with_name(f"{file.name}.zstd").write_bytes(
            zstandard.ZstdCompressor().compress(file.read_bytes())
        )
        file.unlink()
    change(bag, lambda about: about.update(
        relative_file_paths=[f"{name}.zstd" for name in about["relative_file_paths"]]))  # fmt: skip
    assert imported(bag)[0] == numbers()
    (bag / "metadata.yaml").unlink()
    assert imported(bag)[0] == numbers()
    damaged = sorted(bag.iterdir())[1]
    damaged.write_bytes(b"no zstd")
    texts, balance, _ = imported(bag)
    assert len(texts) == 12 and damaged.name in next(iter(balance.left_out))


def test_messages_without_a_topic_in_the_file_are_counted(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [rows([CHAT])], "sqlite3")
    with closing(sqlite3.connect(bag / "bag_0.db3")) as base, base:
        base.execute("UPDATE messages SET topic_id = 77 WHERE id > 15")
        base.execute("UPDATE messages SET timestamp = -5 WHERE id = 1")
        base.execute("UPDATE messages SET data = 'text' WHERE id = 2")
    texts, balance, _ = imported(bag)
    assert texts == numbers()[2:15] and balance.read == 20 and sum(balance.left_out.values()) == 7


def test_messages_of_a_database_that_was_not_closed_are_read(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [rows([CHAT])], "sqlite3")
    with closing(sqlite3.connect(bag / "bag_0.db3")) as base:
        base.execute("PRAGMA journal_mode=WAL")
        base.execute("INSERT INTO messages VALUES(NULL, 1, ?, ?)", [START_NS + 30, text("last")])
        base.commit()
        shutil.copytree(bag, tmp_path / "copy")
    assert imported(tmp_path / "copy")[0] == [*numbers(), "last"]


def test_damaged_files_are_read_as_far_as_they_are_whole(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [rows([CHAT])[:10], rows([CHAT])[10:]], "mcap")
    second = bag / "bag_1.mcap"
    second.write_bytes(second.read_bytes()[:300])
    texts, balance, _ = imported(bag)
    assert texts == numbers(10) and "bag_1.mcap that is damaged" in next(iter(balance.left_out))


def test_damaged_database_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    messages = [(CHAT, START_NS + n, text(f"{n}" * 1000)) for n in range(100)]
    bag = write_bag(tmp_path / "bag", [messages], "sqlite3")
    file = bag / "bag_0.db3"
    data = bytearray(file.read_bytes())
    data[len(data) // 2 :] = bytes(len(data) - len(data) // 2)
    file.write_bytes(data)
    _, balance, _ = imported(bag)
    assert balance.read == 100 and sum(balance.left_out.values()) > 0


def test_files_that_are_no_part_are_named(tmp_path: Path) -> None:
    bag = two_parts(tmp_path / "bag", "sqlite3")
    shutil.copy(bag / "bag_0.db3", bag / "backup.db3")
    (bag / "bag_2.db3").touch()
    texts, balance, notes = imported(bag)
    assert texts == numbers() and not balance.left_out
    assert any("backup.db3 is no part of the bag" in note for note in notes) and "bag_2.db3 is empty" in notes
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BagUnreadable, match=r"has several bags \(backup, bag\); name a file"):
        imported(bag)
    assert imported(bag / "backup.db3")[1].used == 12


@pytest.mark.parametrize("name", ["empty", "a.mcap", "a.db3", "none"])
def test_what_is_no_bag_is_refused(tmp_path: Path, name: str) -> None:
    if name == "empty":
        (tmp_path / name).mkdir()
    elif name != "none":
        (tmp_path / name).write_bytes(b"hello")
    with pytest.raises(BagUnreadable, match="cannot be read as a bag of ROS"):
        imported(tmp_path / name)
    assert not (tmp_path / "imported.mcap").exists()


def parts_of(log: Log) -> list[str]:
    return [part.path.name for part in log.parts]


def test_parts_that_rosbag2_has_numbered_are_one_log(tmp_path: Path) -> None:
    messages = rows([CHAT], 24)
    bag = write_bag(tmp_path / "bag", [messages[n : n + 2] for n in range(0, 24, 2)], "mcap")
    names = [f"bag_{n}.mcap" for n in range(12)]
    with open_log(bag) as log:
        assert parts_of(log) == names and log.message_count == 24
    assert main(["export", str(bag), str(tmp_path / "out")]) == 0
    assert len((tmp_path / "out" / "chat.csv").read_text().splitlines()) == 25
    moved = bag.rename(tmp_path / "moved")
    with open_log(moved) as log:  # by metadata.yaml
        assert parts_of(log) == names
    (moved / "metadata.yaml").unlink()
    with open_log(moved) as log:  # by their numbers from 0
        assert parts_of(log) == names
    (moved / "bag_0.mcap").unlink()
    with open_log(
        moved.rename(tmp_path / "bag")
    ) as log:  # by the folder's name: rosbag2 may remove old parts
        assert parts_of(log) == names[1:]


def test_notes_and_losses_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {"bag_0.mcap": rows([CHAT, Topic("/bad", "a_msgs/msg/B", None, "")])}
    bag = tmp_path / "bag"
    bag.mkdir()
    write_mcap(bag / "bag_0.mcap", files["bag_0.mcap"])
    (bag / "metadata.yaml").write_text(yaml.safe_dump(metadata({"bag_0.mcap": rows([CHAT])}, "mcap")))
    assert main(["import-rosbag", str(bag), str(tmp_path / "a.mcap")]) == 1
    shown = capsys.readouterr()
    assert "read 20 messages: 10 used, 10 left out" in shown.out
    assert "left out 10: messages of /bad, whose type is not known" in shown.err
    assert "metadata.yaml counts 0 messages of /bad, the files hold 10" in shown.err
    assert main(["import-rosbag", str(bag), str(tmp_path / "b.mcap"), "--strict"]) == 1
    assert "Traceback" not in capsys.readouterr().err


def test_one_file_of_a_bag_is_read(tmp_path: Path) -> None:
    write_sqlite(tmp_path / "one.db3", rows([CHAT], 4), schema=1)
    assert imported(tmp_path / "one.db3")[0] == numbers(4)
