"""A state survives encoding and decoding; data that is not a checkpoint is refused."""

import contextlib
import json
import struct
import zlib
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointTooNew, UnsupportedState
from robbie_mp.bus.checkpoint.image import (
    CRC_BEGIN,
    HEADER,
    ImageHeader,
    aligned,
    decode,
    encode,
    lay_out,
    write_header,
)
from tests.bus.checkpoint._support.states import STATES, same

STATE = {
    "map": np.arange(12, dtype=">i4").reshape(3, 4),
    "poses": [(1.0, 2.0)],
    "name": "arena",
    "raw": b"\0\xff",
}


@settings(deadline=None)
@given(STATES)
@example({"nan": float("nan"), "minus zero": -0.0, "infinite": float("-inf"), 1: True})
@example(
    [np.zeros((0, 3)), np.array(5), np.float32(1.5), np.bool_(True), np.datetime64("NaT", "s"), np.str_("ä")]
)
def test_state_is_restored_unchanged(state: Any) -> None:
    assert same(decode(encode(state)).state, state)


def test_sequence_and_time_are_restored() -> None:
    found = decode(encode(STATE, sequence=7, taken_ns=123))
    assert (found.sequence, found.taken_ns) == (7, 123)


def test_arrays_are_restored_as_writable_copies() -> None:
    image = encode(STATE)
    state = decode(image).state
    state["map"][0, 0] = 99
    assert decode(image).state["map"][0, 0] == 0
    assert state["map"].base is None, "it would keep the whole checkpoint in memory"


def test_same_state_has_the_same_bytes() -> None:
    image = bytearray(b"\xff" * lay_out(STATE).size)
    lay_out(STATE).write(memoryview(image), 1, 0)
    assert image == encode(STATE)


def test_arrays_are_aligned() -> None:
    layout = lay_out([np.zeros(3, np.int8), np.zeros(2), b"x", np.zeros(1, np.complex128)])
    assert [offset for offset, _ in layout.pieces] == [0, 64, 128, 192]


def nested(depth: int) -> list[Any]:
    state: list[Any] = []
    for _ in range(depth):
        state = [state]
    return state


def itself() -> list[Any]:
    state: list[Any] = []
    state.append(state)
    return state


@pytest.mark.parametrize(
    ("state", "text"),
    [
        ({"counts": Counter("abc")}, r"state\['counts'\] is a collections.Counter"),
        ([1, {"x": {2, 3}}], r"state\[1\]\['x'\] is a builtins.set"),
        ({(1, frozenset()): 1}, r"a key of state\[1\] is a builtins.frozenset"),
        ([np.array([None])], r"state\[0\] is an array of object"),
        ([np.zeros(2, [("x", "f4")])], r"state\[0\] is an array of \[\('x', '<f4'\)\]"),
        ([np.ma.masked_array([1])], r"MaskedArray"),
        (object(), "state is a builtins.object"),
        ("\ud800", "cannot be stored"),
        ([10**5000], "cannot be stored"),
        (nested(200), "deeper than 100 levels"),
        (itself(), "contains itself"),
    ],
)
def test_value_that_is_not_plain_data_is_refused_with_its_place(state: Any, text: str) -> None:
    with pytest.raises(UnsupportedState, match=text):
        encode(state)


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_arbitrary_bytes_are_not_a_checkpoint(data: bytes) -> None:
    with pytest.raises((CheckpointDamaged, CheckpointTooNew)):
        decode(data)


@settings(deadline=None)
@given(st.data())
def test_any_changed_byte_is_detected(data: st.DataObject) -> None:
    image = bytearray(encode(STATE))
    image[data.draw(st.integers(0, len(image) - 1))] ^= data.draw(st.integers(1, 255))
    with pytest.raises((CheckpointDamaged, CheckpointTooNew)):
        decode(bytes(image))


def test_any_truncation_is_detected() -> None:
    image = encode(STATE)
    for size in range(len(image)):
        with pytest.raises(CheckpointDamaged):
            decode(image[:size])


def test_newer_format_is_reported_as_newer() -> None:
    image = bytearray(encode(STATE))
    struct.pack_into("<I", image, 8, 2)
    with pytest.raises(CheckpointTooNew, match="format 2"):
        decode(bytes(image))


def with_structure(structure: bytes, pieces: bytes = bytes(256)) -> bytes:
    """An image whose CRC is right, whatever its structure."""
    begin = aligned(HEADER.size + len(structure))
    image = bytearray(begin + len(pieces))
    image[HEADER.size : HEADER.size + len(structure)] = structure
    image[begin:] = pieces
    write_header(memoryview(image), ImageHeader(len(image), len(structure), 1, 0))
    assert zlib.crc32(image[CRC_BEGIN:]) == struct.unpack_from("<I", image, 12)[0]
    return bytes(image)


JUNK = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3))
TAGS = st.sampled_from(["tuple", "dict", "bytes", "array", "scalar", "other"])
DESCRIPTIONS = st.tuples(
    st.one_of(st.sampled_from(["<f4", "|b1", "<U2", "|O", "|S0", "<m8[s]", "<f3", "<M8[7Q]", "|V8"]), JUNK),
    st.one_of(st.lists(st.one_of(st.integers(-2, 70), st.just(2**62), JUNK), max_size=3), JUNK),
    st.one_of(st.integers(-64, 320), JUNK),
).map(list)
NODES = st.recursive(
    JUNK,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(TAGS, st.one_of(inner, st.lists(inner, max_size=3), DESCRIPTIONS), max_size=2),
    ),
)


@settings(max_examples=400, deadline=None)
@given(st.one_of(st.binary(max_size=50), NODES.map(lambda node: json.dumps(node).encode())))
@example(b"[" * 100_000)
@example(b'{"array":["<f4",["ab",1000000000000],0]}')
@example(b'{"array":["|S0",[4611686018427387904],0]}')
@example(b'{"array":["<f4",[4294967296,4294967296],0]}')
@example(b'{"bytes":[0,1e400]}')
@example(b"1" * 5000)
def test_random_structure_is_damage_or_a_state(structure: bytes) -> None:
    with contextlib.suppress(CheckpointDamaged):
        decode(with_structure(structure))


def test_pieces_cannot_be_counted_twice() -> None:
    one = json.dumps([{"bytes": [0, 256]}]).encode()
    assert decode(with_structure(one)).state == [bytes(256)]
    with pytest.raises(CheckpointDamaged):
        decode(with_structure(json.dumps([{"bytes": [0, 256]}] * 2).encode()))
