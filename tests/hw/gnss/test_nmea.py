"""Sentences of NMEA 0183, also as pynmea2 reads them."""

import math
from typing import Any

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.gnss import nmea
from robbie_robots.hw.gnss.nmea import FixQuality, NmeaFraming, Sentence
from tests.hw._support.captures import CAPTURES, decoded_in_pieces, needs_captures

GGA = b"$GPGGA,184353.07,1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,0000*6D\r\n"
OTHERS = (
    b"$GPRTE,2,1,c,0,PBRCPK,PBRTO,PTELGR,PPLAND,PYAMBU,PPFAIR,PWARRN,PMORTL,PLISMR*73\r\n"
    b"$IIMWV,271.0,R,000.2,N,A*3B\r\n"
    b"$GPR00,A,B,C*29\r\n"
)


def decoded(data: bytes) -> list[Sentence]:
    return FrameDecoder(NmeaFraming()).feed(data)


def test_position_has_degrees_with_the_sign_of_its_hemisphere() -> None:
    (sentence,) = decoded(GGA)
    fix = nmea.position_fix(sentence)
    assert fix.latitude_deg == pytest.approx(-19.4840833, abs=1e-7)
    assert fix.longitude_deg == pytest.approx(24.1751, abs=1e-7)
    assert (fix.altitude_m, fix.geoid_m, fix.satellites) == (100.0, -33.9, 4)
    assert fix.quality is FixQuality.SATELLITES
    assert fix.time_of_day_s == pytest.approx(18 * 3600 + 43 * 60 + 53.07)


def test_sentence_encodes_to_the_same_bytes() -> None:
    for line in (GGA, *OTHERS.splitlines(keepends=True)):
        (sentence,) = decoded(line)
        text = ",".join((sentence.talker + sentence.kind, *sentence.fields))
        assert nmea.sentence(text) == line


def test_long_and_unusual_sentences_are_read() -> None:
    assert [sentence.kind for sentence in decoded(OTHERS)] == ["RTE", "MWV", "R00"]


def test_maker_s_own_sentence_has_no_talker() -> None:
    (sentence,) = decoded(nmea.sentence("PUBX,00,A"))
    assert sentence == Sentence("", "PUBX", ("00", "A"))


def test_speed_is_in_metres_per_second() -> None:
    (sentence,) = decoded(nmea.sentence("GNRMC,103607.00,A,5327.03942,N,00214.42462,W,10.0,90.0,060321,,,A"))
    motion = nmea.motion(sentence)
    assert motion.speed_m_per_s == pytest.approx(5.14444, abs=1e-5)
    assert (motion.valid, motion.course_deg) == (True, 90.0)
    assert motion.longitude_deg == pytest.approx(-2.240410, abs=1e-6)


def test_receiver_without_a_fix_reports_no_numbers() -> None:
    (sentence,) = decoded(nmea.sentence("GPGGA,,,,,,0,00,99.99,,,,,,"))
    fix = nmea.position_fix(sentence)
    assert fix.quality is FixQuality.NONE
    assert math.isnan(fix.latitude_deg) and math.isnan(fix.altitude_m)


@pytest.mark.parametrize(
    "line",
    [
        GGA.replace(b"6D", b"6E"),
        b"$GPGGA,1" + GGA[:-5],
        b"$gpgga,1*00\r\n",
        b"$" + b"A" * 2000,
        GGA.replace(b"184353", b"18435\xb3"),
    ],
)
def test_damaged_sentence_is_dropped_and_the_next_is_read(line: bytes) -> None:
    decoder = FrameDecoder(NmeaFraming())
    assert [sentence.kind for sentence in decoder.feed(line + OTHERS)] == ["RTE", "MWV", "R00"]
    assert decoder.damaged


@pytest.mark.parametrize(
    "fields",
    [
        "1x.5,1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,E,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,S,02410.506,E,99,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,S,02410.506,E,1,04,nan,100.00,M,-33.9,M,,",
        "184353,1929.045,S",
        "184353,1967.0,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,9100.0,N,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,9000.001,N,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,S,19130.000,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,S,18000.001,W,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,-1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "244353,1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "186053,1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184361,1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,S,02410.506,E,1,04,2.6,328.1,F,-33.9,M,,",
        "184353,1929.045,S,02410.506,E,1,04,-2.6,100.00,M,-33.9,M,,",
        "184353,1929.045,S,02410.506,E,1,04,2.6," + "9" * 400 + ",M,-33.9,M,,",
        "184353,1929.045,S,02410.506,E,-1,04,2.6,100.00,M,-33.9,M,,",
    ],
)
def test_malformed_field_is_damage(fields: str) -> None:
    (sentence,) = decoded(nmea.sentence("GPGGA," + fields))
    with pytest.raises(DamagedFrame):
        nmea.position_fix(sentence)


@pytest.mark.parametrize(
    ("quality", "is_measured", "is_corrected"),
    [
        (0, False, False),
        (1, True, False),
        (2, True, True),
        (3, True, False),
        (4, True, True),
        (5, True, True),
        (6, False, False),
        (7, False, False),
        (8, False, False),
        (9, True, True),
    ],
)
def test_quality_tells_whether_satellites_gave_the_position(
    quality: int, is_measured: bool, is_corrected: bool
) -> None:
    (sentence,) = decoded(nmea.sentence(GGA.decode()[1:-5].replace(",E,1,", f",E,{quality},")))
    told = nmea.position_fix(sentence).quality
    assert (told.is_measured, told.is_corrected) == (is_measured, is_corrected)


@pytest.mark.parametrize("talker", ["GP", "GN", "GA", "GB", "GQ", "GL", "BD"])
def test_every_talker_is_read(talker: str) -> None:
    (sentence,) = decoded(nmea.sentence(talker + GGA.decode()[3:-5]))
    assert (sentence.talker, nmea.position_fix(sentence).satellites) == (talker, 4)


@pytest.mark.parametrize("ends", [b"\r\n", b"\n", b"\r", b""])
def test_sentences_may_follow_without_an_end_of_line(ends: bytes) -> None:
    one = GGA.rstrip()
    sentences = decoded(one + ends + one.replace(b"*6D", b"*6d") + ends + OTHERS)
    assert [each.kind for each in sentences] == ["GGA", "GGA", "RTE", "MWV", "R00"]


@pytest.mark.parametrize("dilution", ["", "99.99", "99.9", "0.0", "0"])
def test_dilution_that_is_none_is_unknown(dilution: str) -> None:
    (sentence,) = decoded(nmea.sentence(GGA.decode()[1:-5].replace(",2.6,", f",{dilution},")))
    assert math.isnan(nmea.position_fix(sentence).horizontal_dilution)


def test_leap_second_and_limits_of_coordinates_are_read() -> None:
    (sentence,) = decoded(nmea.sentence("GPGGA,235960.50,9000.000,S,18000.000,W,1,04,2.6,1,M,,M,,"))
    fix = nmea.position_fix(sentence)
    assert (fix.latitude_deg, fix.longitude_deg, fix.time_of_day_s) == (-90.0, -180.0, 86400.5)


COORDINATES = st.one_of(
    st.from_regex(r"[0-9]{1,3}[0-9]{2}(\.[0-9]{0,6})?", fullmatch=True),
    st.from_regex(r"[-+]?[0-9]{0,6}\.?[0-9]{0,3}", fullmatch=True),
    st.text("0123456789.-+eE naif", max_size=8),
)


@pytest.mark.slow
@given(COORDINATES, st.sampled_from("NSEWn "), COORDINATES, st.sampled_from("EWNSe "))
def test_coordinates_are_those_of_pynmea2_or_refused(
    latitude: str, north: str, longitude: str, east: str
) -> None:
    line = nmea.sentence(f"GNGGA,184353,{latitude},{north},{longitude},{east},1,04,2.6,100.0,M,1,M,,")
    (sentence,) = decoded(line)
    try:
        fix = nmea.position_fix(sentence)
    except DamagedFrame:
        return
    told = witness(line)
    for ours, text, limit, name in (
        (fix.latitude_deg, latitude, 90.0, "latitude"),
        (fix.longitude_deg, longitude, 180.0, "longitude"),
    ):
        assert math.isnan(ours) if not text else abs(ours) <= limit
        if "." in text and not text.endswith("."):  # pynmea2 wants a decimal point and a digit
            assert ours == pytest.approx(getattr(told, name))


def witness(line: bytes) -> Any:
    """Return the sentence as pynmea2 reads it; None if it refuses the line."""
    try:
        return pynmea2.parse(line.decode("latin-1"), check=True)
    except (pynmea2.ParseError, ValueError):
        return None


@needs_captures
def test_real_recordings_are_read_as_by_pynmea2() -> None:
    checked = compared = 0
    for path in sorted((CAPTURES / "nmea").iterdir()):
        data = path.read_bytes()
        sentences = decoded_in_pieces(FrameDecoder(NmeaFraming()), data)
        read = {",".join((each.talker + each.kind, *each.fields)): each for each in sentences}
        # A line of the mixed recordings may begin with bytes of another protocol.
        lines = [line[line.find(b"$") :] for line in data.split(b"\r\n")[:-1] if b"$" in line]
        for line in lines:
            text = line[1:].rpartition(b"*")[0].decode("latin-1")
            if (told := witness(line)) is not None:
                assert text in read, line
                checked += 1
                compared += _compare(read[text], told)
    assert (checked, compared) >= (80, 6)


def _compare(sentence: Sentence, told: Any) -> int:
    if sentence.kind == "GGA":
        fix = nmea.position_fix(sentence)
        if not math.isnan(fix.latitude_deg):
            assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((told.latitude, told.longitude))
            assert fix.altitude_m == pytest.approx(float(told.altitude))
        return 1
    if sentence.kind == "RMC":
        motion = nmea.motion(sentence)
        if told.spd_over_grnd is not None:
            assert motion.speed_m_per_s == pytest.approx(float(told.spd_over_grnd) * 0.514444, rel=1e-5)
        return 1
    return 0
