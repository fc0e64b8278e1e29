"""MIP packets."""

import pytest

from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.microstrain import mip
from robbie_robots.hw.microstrain.mip import MipField, MipFraming, MipPacket, SensorField
from tests.hw._support.captures import CAPTURES, decoded_in_pieces, needs_captures

PING = bytes.fromhex("75 65 01 02 02 01 E0 C6")
ACCELERATION = bytes.fromhex("75 65 80 0E 0E 04 3F 80 00 00 40 00 00 00 C0 40 00 00 79 ED")


def test_ping_has_the_bytes_of_the_manual() -> None:
    assert mip.packet(1, [MipField(1, b"")]) == PING
    (packet,) = FrameDecoder(MipFraming()).feed(PING)
    assert (packet.descriptor_set, packet.fields) == (1, (MipField(1, b""),))


def test_acceleration_of_the_manual_is_decoded_and_encoded() -> None:
    (packet,) = FrameDecoder(MipFraming()).feed(ACCELERATION)
    assert mip.sensor_values(packet) == {SensorField.ACCELERATION: (1.0, 2.0, -3.0)}
    assert mip.packet(packet.descriptor_set, packet.fields) == ACCELERATION


def test_answers_name_the_command_and_its_error() -> None:
    packet = MipPacket(0x0C, bytes.fromhex("04 F1 08 00 04 F1 11 03"))
    assert mip.replies(packet) == [(0x08, 0), (0x11, 3)]


def test_field_of_another_length_is_damage() -> None:
    with pytest.raises(DamagedFrame, match="field 04 has 4 bytes"):
        mip.sensor_values(MipPacket(0x80, bytes([6, 0x04]) + bytes(4)))
    for payload in ("00 04", "05 04 00"):
        body = bytes.fromhex("75 65 80") + bytes([len(bytes.fromhex(payload))]) + bytes.fromhex(payload)
        decoder = FrameDecoder(MipFraming())
        assert decoder.feed(body + mip.checksum(body)) == []
        assert decoder.damaged == 1


@needs_captures
def test_every_packet_of_a_real_recording_is_decoded() -> None:
    data = (CAPTURES / "mip" / "mip_data_first_120000_bytes.bin").read_bytes()
    decoder = FrameDecoder(MipFraming())
    packets = decoded_in_pieces(decoder, data)
    assert (decoder.frames, decoder.damaged, decoder.skipped_bytes) == (2656, 0, 0)
    assert b"".join(mip.packet(packet.descriptor_set, packet.fields) for packet in packets) == data
    read = [mip.sensor_values(packet) for packet in packets]
    gravity = [values[SensorField.ACCELERATION] for values in read if SensorField.ACCELERATION in values]
    assert len(gravity) == 1510
    assert all(0.7 < sum(axis**2 for axis in each) ** 0.5 < 1.3 for each in gravity)
