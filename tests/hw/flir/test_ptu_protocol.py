"""Commands and answers of pan-tilt units, with the dialogues of the maker's manual."""

import pytest

from robbie_robots.hw.flir import ptu_protocol as ptu
from robbie_robots.hw.flir.ptu_protocol import Axis, PtuAnswer, PtuFraming
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder


def answers(data: bytes) -> list[PtuAnswer]:
    return FrameDecoder(PtuFraming()).feed(data)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"* 0\r\n", 0),
        (b"PP * Current Pan position is 0\r\n", 0),
        (b"PN * Minimum Pan position is -3090\r\n", -3090),
        (b"TX * 604\r\n", 604),
        (b"PR * 185.1428 seconds arc per Pan position\r\n", 185.1428),
    ],
)
def test_answers_of_the_manual_yield_their_number(line: bytes, expected: float) -> None:
    (answer,) = answers(line)
    assert ptu.number(answer) == expected


def test_refusal_tells_its_reason() -> None:
    (answer,) = answers(b"PP3200 ! Maximum allowable Pan position is 3090\r\n")
    assert answer == PtuAnswer(False, "Maximum allowable Pan position is 3090")
    with pytest.raises(DamagedFrame, match="no number"):
        ptu.number(answer)


def test_texts_of_the_manual_are_read() -> None:
    version = (
        b"V * Pan-Tilt Controller v2.12.1d1(C14/E), (C)2003 Directed Perception, Inc., "
        b"All Rights Reserved\r\n"
    )
    (answer,) = answers(version)
    assert answer.accepted and answer.text.startswith("Pan-Tilt Controller v2.12")
    (limits,) = answers(b"L * Limit bounds are ENABLED (soft limits enabled)\r\n")
    assert "ENABLED" in limits.text


def test_limits_hit_during_a_reset_are_told_apart_from_its_answer() -> None:
    found = answers(b"!T!T!P!P*\r\n")
    assert [answer.limit_hit for answer in found] == [Axis.TILT, Axis.TILT, Axis.PAN, Axis.PAN, None]
    assert found[-1] == PtuAnswer(True, "")


def test_commands_end_with_a_delimiter() -> None:
    assert ptu.move(Axis.PAN, -100) == b"PP-100 "
    assert ptu.speed(Axis.TILT, 900) == b"TS900 "
    assert ptu.ask(Axis.TILT, "R") == b"TR "
    assert ptu.echo_off() + ptu.terse() + ptu.halt() == b"ED FT H "
