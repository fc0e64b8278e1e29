"""What a real URG-04LX sent is understood to the last line."""

from robbie_robots.hw.hokuyo.scip import ReplyReader, measurement, parameters
from tests.hw._support.captures import CAPTURES, needs_captures


@needs_captures
def test_session_of_a_real_laser_has_no_damaged_line() -> None:
    reader = ReplyReader()
    replies = reader.feed((CAPTURES / "hokuyo/example_urg_04lx.logr.bytes").read_bytes(), 0.0)
    assert (reader.damaged, reader._buffer) == (0, b"")
    told = [(reply.echo, reply.status) for reply in replies]
    assert told == [
        ("VV", "00"), ("VV", "00"), ("PP", "00"), ("II", "00"), ("BM", "02"),
        ("CR00", "03"), ("VV", "00"), ("PP", "00"), ("II", "00"), ("GD0044072501", "00"),
    ]  # fmt: skip
    names = {reply.echo: parameters(reply.lines) for reply in replies if reply.echo in ("VV", "PP", "II")}
    assert names["VV"]["SERI"] == "H0706400"
    assert parameters(replies[3].lines)["TIME"] == "6A5404"
    steps = {"DMIN": 20, "DMAX": 5600, "ARES": 1024, "AMIN": 44, "AMAX": 725, "AFRT": 384, "SCAN": 600}
    assert {name: int(names["PP"][name]) for name in steps} == steps
    sweep = measurement(replies[-1])
    assert len(sweep.ranges_mm) == 682
    # The witness: the same characters by the rule of the specification, without numpy.
    characters = b"".join(line[:-1] for line in replies[-1].lines[1:])
    by_hand = [
        sum((characters[at + place] - 48) << 6 * (2 - place) for place in range(3))
        for at in range(0, len(characters), 3)
    ]
    assert sweep.ranges_mm.tolist() == by_hand
