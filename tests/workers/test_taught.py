"""The file with what was taught is checked when it is read."""

import json
from pathlib import Path

import pytest

from robbie_robots.workers import taught
from robbie_robots.workers.taught import MAX_EXAMPLES, MAX_NAMES, TaughtFileError, as_json, read_taught


def test_file_is_read_as_it_was_written_and_a_missing_one_has_nothing(tmp_path: Path) -> None:
    file = tmp_path / "taught.json"
    assert read_taught(file, "objects") == {}
    file.write_bytes(as_json("objects", {"Tee": ["x"]}))
    assert read_taught(file, "objects") == {"Tee": ["x"]}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "cannot be read as JSON"),
        ("[" * 100_000, "cannot be read as JSON"),
        ("[]", "expected version 1 and kind 'objects'"),
        (json.dumps({"version": 2, "kind": "objects", "taught": {}}), "expected version 1"),
        (as_json("persons", {}).decode(), "kind 'objects'"),
        (as_json("objects", {"tea": []}).decode(), "must map each name to a list of examples"),
        (as_json("objects", {"tea": "x"}).decode(), "must map each name to a list of examples"),
        (as_json("objects", {"": ["x"]}).decode(), "a name has 1 to 64"),
        (as_json("objects", {"tea": ["x"] * (MAX_EXAMPLES + 1)}).decode(), "at most 32 names with 8"),
        (as_json("objects", {f"{n}": ["x"] for n in range(MAX_NAMES + 1)}).decode(), "at most 32 names"),
    ],
)
def test_other_and_damaged_files_are_refused(tmp_path: Path, text: str, why: str) -> None:
    file = tmp_path / "taught.json"
    file.write_text(text)
    with pytest.raises(TaughtFileError, match=why) as caught:
        read_taught(file, "objects")
    assert str(caught.value).startswith(str(file))


def test_too_large_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "taught.json"
    file.write_bytes(as_json("objects", {}))
    monkeypatch.setattr(taught, "MAX_FILE_BYTES", 5)
    with pytest.raises(TaughtFileError, match="is larger than"):
        read_taught(file, "objects")
