"""YAML becomes values with lines, and every kind of broken YAML an error with its line."""

import math
from pathlib import Path

import pytest

from robbie_mp.base.problem import ProfileError, SourcePlace
from robbie_mp.base.yaml_reader import MAX_DEPTH, YamlNode, read_file, read_text

FILE = Path("/ws/p.yaml")


def problem(text: str) -> str:
    with pytest.raises(ProfileError) as caught:
        read_text(text, FILE)
    return str(caught.value).removeprefix("/ws/")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("# nothing", None),
        ("~", None),
        ("null", None),
        ("true", True),
        ("False", False),
        ("no", "no"),
        ("on", "on"),
        ("12", 12),
        ("-007", -7),
        ("0x1F", 31),
        ("0o17", 15),
        ("1_000", "1_000"),
        ("18446744073709551615", 2**64 - 1),
        ("1e-3", 0.001),
        ("+.5", 0.5),
        ("1.", 1.0),
        ("-.INF", -math.inf),
        ("1.2.3", "1.2.3"),
        ("2024-01-01", "2024-01-01"),
        ("10:30:00", "10:30:00"),
        ("'12'", "12"),
        ("!!str 12", "12"),
        ("!!float 12", 12.0),
        ("[1, {a: b}]", [1, {"a": "b"}]),
        ("|\n a\n b", "a\nb"),
    ],
)
def test_scalars_are_those_of_the_core_schema(text: str, value: object) -> None:
    got = read_text(text, FILE).plain()
    assert got == value
    assert type(got) is type(value)


def test_nan_is_read() -> None:
    got = read_text(".NaN", FILE).plain()
    assert isinstance(got, float) and math.isnan(got)


def test_values_have_the_line_of_their_key_and_elements_their_own_line() -> None:
    root = read_text("a: 1\nb:\n  c:\n    2\n  d:\n  - x\n  - y\n", FILE)
    assert isinstance(root.value, dict)
    b = root.value["b"].value
    assert isinstance(b, dict)
    assert (root.value["b"].place, b["c"].place) == (SourcePlace(FILE, 2), SourcePlace(FILE, 3))
    elements = b["d"].value
    assert isinstance(elements, list)
    assert [element.place.line for element in elements] == [6, 7]


def test_alias_is_a_copy_of_its_anchor() -> None:
    assert read_text("a: &x {b: 1}\nc: *x", FILE).plain() == {"a": {"b": 1}, "c": {"b": 1}}


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a: 1\nb: 2\na: 3", "p.yaml:3: YAML: key 'a' is set twice, first at /ws/p.yaml:1"),
        (
            "a:\n\tb: 1",
            "p.yaml:2: YAML: while scanning for the next token found character '\\t' that cannot start any "
            "token; indent with spaces, not with tabs",
        ),
        ("a: 1\nb: c: d", "p.yaml:2: YAML: mapping values are not allowed here"),
        (
            "a: [1,\n2",
            "p.yaml:2: YAML: while parsing a flow sequence expected ',' or ']', but got '<stream end>'",
        ),
        ("a: 1\nb: *x", "p.yaml:2: YAML: found undefined alias 'x'"),
        (
            "a: 1\n---\nb: 2",
            "p.yaml:2: YAML: expected a single document in the stream but found another document",
        ),
        ("a: 1\nb: \x01", "p.yaml:2: YAML: character #x0001 is not allowed"),
        ('a: 1\nb: "\\UFFFFFFFF"', "p.yaml:2: YAML: an escape names no character"),
        ("a: 1\n2: b", "p.yaml:2: YAML: expected a str as key; got '2'; quote it"),
        ("a: 1\n? [x]\n: b", "p.yaml:2: YAML: expected a str as key; got ["),
        ("a: 1\nb: 99999999999999999999", "p.yaml:2: YAML: 99999999999999999999 does not fit into 64 bits"),
        ("a: 1\nb: 0x" + "f" * 6000, "p.yaml:2: YAML: 0xffffffffffffffffffffffffffffffffffffff does not fit"),
        ("a: 1\nb: " + "1" * 6000, "p.yaml:2: YAML: 1111111111111111111111111111111111111111 does not fit"),
        ("a: 1\nb: !!int x", "p.yaml:2: YAML: 'x' is not of type int"),
        (
            "a: !!python/object/apply:os.system [x]",
            "p.yaml:1: YAML: tag 'tag:yaml.org,2002:python/object/apply:os.system' is not supported",
        ),
        ("a: !new x", "p.yaml:1: YAML: tag '!new' is not supported"),
        ("a: &x {b: 1}\nc:\n  <<: *x", "p.yaml:3: YAML: merge keys (<<) are not supported; use a parent"),
        ("a: 1\nb: &x [*x]", "p.yaml:2: YAML: an alias (*) inside the value that it refers to"),
    ],
)
def test_broken_yaml_is_an_error_with_its_line(text: str, error: str) -> None:
    assert problem(text).startswith(error)


@pytest.mark.parametrize("depth", [MAX_DEPTH + 1, 200, 500])
def test_deep_nesting_is_refused(depth: int) -> None:
    assert (
        problem("a: 1\nb: " + "[" * depth + "]" * depth)
        == f"p.yaml:2: YAML: nested deeper than {MAX_DEPTH} levels"
    )


def test_nested_aliases_cannot_fill_the_memory() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12)]
    assert "more than 100000 values" in problem("\n".join(lines))


def test_file_that_is_not_utf8_is_an_error_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_bytes(b"a: 1\nb: \xff")
    with pytest.raises(ProfileError, match=r"p\.yaml:2: expected UTF-8 text; got other bytes$"):
        read_file(tmp_path / "p.yaml")


def test_file_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r": cannot be read: Is a directory$"):
        read_file(tmp_path)


def test_plain_data_of_a_node_has_no_line_numbers() -> None:
    place = SourcePlace(FILE, 1)
    assert YamlNode({"a": YamlNode([YamlNode(1, place)], place)}, place).plain() == {"a": [1]}
