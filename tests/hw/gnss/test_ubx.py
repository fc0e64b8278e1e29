"""UBX messages, also as pyubx2 reads and writes them."""

import io
import struct

import pytest
import pyubx2

from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.gnss import ubx
from robbie_robots.hw.gnss.ubx import FixType, UbxFraming, UbxMessage
from tests.hw._support.captures import CAPTURES, decoded_in_pieces, needs_captures


def test_messages_have_the_bytes_of_the_manual() -> None:
    assert ubx.message(0x0A, 0x04) == bytes.fromhex("B5 62 0A 04 00 00 0E 34")
    assert ubx.set_rate(100) == bytes.fromhex("B5 62 06 08 06 00 64 00 01 00 00 00 79 10")


def test_decoded_message_encodes_to_the_same_bytes() -> None:
    data = ubx.set_rate(100)
    (message,) = FrameDecoder(UbxFraming()).feed(data)
    assert message == UbxMessage(0x06, 0x08, bytes.fromhex("64 00 01 00 00 00"))
    assert ubx.message(*message) == data


def test_switching_a_message_on_is_as_pyubx2_writes_it() -> None:
    theirs = pyubx2.UBXMessage("CFG", "CFG-MSG", pyubx2.SET, msgClass=1, msgID=7, rateUART1=1)
    assert ubx.enable_message(1, 7)[:3] == theirs.serialize()[:3]
    assert ubx.enable_message(1, 7)[6:9] == bytes([1, 7, 1])


def test_solution_is_read_as_pyubx2_reads_it() -> None:
    payload = bytearray(92)
    struct.pack_into("<I", payload, 0, 123_456)
    payload[20], payload[21], payload[23] = 3, 1, 12
    struct.pack_into("<iiii", payload, 24, -22402300, 534506925, 86000, 37889)
    struct.pack_into("<II", payload, 40, 1500, 2500)
    struct.pack_into("<iiiii", payload, 48, 1000, -2000, 30, 2236, 29656505)
    data = ubx.message(1, 7, bytes(payload))
    (message,) = FrameDecoder(UbxFraming()).feed(data)
    ours, theirs = ubx.navigation_solution(message), pyubx2.UBXReader.parse(data)
    assert (ours.latitude_deg, ours.longitude_deg) == (53.4506925, -2.24023)
    assert (ours.latitude_deg, ours.longitude_deg) == pytest.approx((theirs.lat, theirs.lon))
    assert (ours.altitude_m, ours.height_m) == (37.889, 86.0)
    assert (ours.altitude_m * 1e3, ours.height_m * 1e3) == pytest.approx((theirs.hMSL, theirs.height))
    assert (ours.fix_type, ours.valid, ours.satellites) == (FixType.THREE_D, True, 12)
    assert (ours.horizontal_accuracy_m, ours.vertical_accuracy_m) == (1.5, 2.5)
    assert ours.velocity_m_per_s == (1.0, -2.0, 0.03)
    assert (ours.ground_speed_m_per_s, ours.course_deg) == pytest.approx((2.236, 296.56505))
    assert ours.course_deg == pytest.approx(theirs.headMot)


def test_message_of_another_length_is_damage() -> None:
    with pytest.raises(DamagedFrame, match="01 07 of 3 bytes is no NAV-PVT"):
        ubx.navigation_solution(UbxMessage(1, 7, bytes(3)))


def test_payload_beyond_the_limit_is_no_message() -> None:
    decoder = FrameDecoder(UbxFraming())
    (found,) = decoder.feed(bytes.fromhex("B5 62 01 07 FF FF") + ubx.set_rate(100))
    assert found.number == 0x08


@needs_captures
def test_real_recordings_are_read_as_by_pyubx2() -> None:
    solutions = 0
    for path in sorted((CAPTURES / "ubx").iterdir()):
        data = path.read_bytes()
        messages = decoded_in_pieces(FrameDecoder(UbxFraming()), data)
        reader = pyubx2.UBXReader(io.BytesIO(data), protfilter=pyubx2.UBX_PROTOCOL, quitonerror=0)
        theirs = [parsed for _, parsed in reader if parsed is not None]
        assert [ubx.message(*each) for each in messages] == [each.serialize() for each in theirs]
        for ours, told in zip(messages, theirs, strict=True):
            if told.identity == "NAV-PVT":
                solutions += 1
                solution = ubx.navigation_solution(ours)
                assert (solution.latitude_deg, solution.longitude_deg) == pytest.approx((told.lat, told.lon))
                assert solution.altitude_m == pytest.approx(told.hMSL / 1e3)
    assert solutions
