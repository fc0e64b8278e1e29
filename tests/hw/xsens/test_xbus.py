"""Xbus messages, with bytes that a real MTi sent."""

import struct

import pytest

from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.xsens import xbus
from robbie_robots.hw.xsens.xbus import MessageId, OutputMode, OutputSettings, XbusData, XbusMessage

# From a real MTi: orientation, acceleration, turn rate, magnetic field, status.
LONG = bytes.fromhex(
    "FA FF 36 4E 10 60 04 02 53 35 CB 20 10 10 3F 7F FA 66 BB 40 34 B8 3C 49 96 2D 3B 5A "
    "1F 82 80 20 0C 39 FF 91 01 BA EC DD 81 BA 86 53 80 40 20 0C BE 64 DB 99 BC E7 FF 83 "
    "41 1D C2 CF C0 20 0C BE 90 48 80 3F 67 32 04 BF 54 89 04 E0 20 04 00 00 00 03 C9 "
)
SHORT = bytes.fromhex("FA FF 36 14 10 20 02 00 09 20 30 0C BF BC 67 E0 3E DF AE 81 40 A3 A9 DF A7")


def decoded(data: bytes) -> XbusMessage:
    (found,) = FrameDecoder(xbus.XbusFraming()).feed(data)
    return found


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (MessageId.GO_TO_CONFIG, "FA FF 30 00 D1"),
        (MessageId.GO_TO_MEASUREMENT, "FA FF 10 00 F1"),
        (MessageId.REQUEST_DEVICE_ID, "FA FF 00 00 01"),
        (MessageId.RESET, "FA FF 40 00 C1"),
        (MessageId.WAKE_UP_ANSWER, "FA FF 3F 00 C2"),
    ],
)
def test_messages_have_the_bytes_of_the_manual(number: MessageId, expected: str) -> None:
    assert xbus.message(number) == bytes.fromhex(expected)
    assert decoded(bytes.fromhex(expected)) == XbusMessage(number, b"")


def test_real_message_yields_orientation_and_motion() -> None:
    told = xbus.data2(decoded(LONG))
    assert told.quaternion == pytest.approx((0.99991, -0.00293, 0.0123, 0.00333), abs=1e-5)
    assert told.acceleration_m_per_s2 == pytest.approx((-0.2235, -0.0283, 9.8601), abs=1e-4)
    assert told.turn_rad_per_s is not None and max(map(abs, told.turn_rad_per_s)) < 0.01
    assert told.status == 3
    assert told.sample_time_s == pytest.approx(0x025335CB / 10_000)


def test_real_message_yields_euler_angles_and_counter() -> None:
    told = xbus.data2(decoded(SHORT))
    assert told.packet_counter == 9
    assert told.euler_deg == pytest.approx((-1.472, 0.437, 5.114), abs=1e-3)
    assert told.quaternion is None


def test_decoded_message_encodes_to_the_same_bytes() -> None:
    for data in (LONG, SHORT):
        assert xbus.message(*decoded(data)) == data


def test_message_of_more_than_254_bytes_has_a_long_length() -> None:
    data = bytes(range(256)) + b"more"
    sent = xbus.message(MessageId.DATA2, data)
    assert sent[3:6] == bytes.fromhex("FF 01 04")
    assert decoded(sent) == XbusMessage(MessageId.DATA2, data)


@pytest.mark.parametrize(
    ("identifier", "value"),
    [
        (0x4020, struct.pack(">3f", 1.5, -2.25, 9.75)),
        (0x4021, struct.pack(">3i", 3 << 19, -9 << 18, 39 << 18)),
        (0x4022, struct.pack(">IhIhIh", 1 << 31, 1, 3 << 30, -3, 3 << 30, 9)),
        (0x4023, struct.pack(">3d", 1.5, -2.25, 9.75)),
    ],
)
def test_each_precision_yields_the_same_numbers(identifier: int, value: bytes) -> None:
    part = struct.pack(">HB", identifier, len(value)) + value
    assert xbus.data2(XbusMessage(MessageId.DATA2, part)).acceleration_m_per_s2 == (1.5, -2.25, 9.75)


def test_part_that_is_cut_or_of_another_length_is_damage() -> None:
    for part in ("40 20", "40 20 0C 00", "40 20 04 00 00 00 00"):
        with pytest.raises(DamagedFrame):
            xbus.data2(XbusMessage(MessageId.DATA2, bytes.fromhex(part)))


def test_older_units_data_follows_what_they_were_told_to_send() -> None:
    mode = OutputMode.TEMPERATURE | OutputMode.CALIBRATED | OutputMode.ORIENTATION | OutputMode.STATUS
    numbers = [21.5, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 30]
    data = struct.pack(">13fBH", *numbers, 7, 4711)
    reader = xbus.OldData(mode, OutputSettings.SAMPLE_COUNTER | OutputSettings.EULER)
    told = reader.read(XbusMessage(MessageId.DATA, data))
    assert told == XbusData(
        packet_counter=4711,
        euler_deg=(10, 20, 30),
        acceleration_m_per_s2=(1, 2, 3),
        turn_rad_per_s=(4, 5, 6),
        magnetic_field=(7, 8, 9),
        temperature_c=21.5,
        status=7,
    )
    with pytest.raises(DamagedFrame, match="not MTData of 55"):
        reader.read(XbusMessage(MessageId.DATA, data[:-1]))


def test_outputs_are_chosen_as_the_manual_says() -> None:
    assert xbus.output_configuration([(0x2010, 100), (0x4020, 100)]) == xbus.message(
        0xC0, bytes.fromhex("20 10 00 64 40 20 00 64")
    )
    assert xbus.output_mode(OutputMode.CALIBRATED) == xbus.message(0xD0, b"\0\x02")
    assert xbus.output_settings(OutputSettings.EULER) == xbus.message(0xD2, b"\0\0\0\x04")
