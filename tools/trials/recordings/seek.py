"""Measures how long a playback takes to seek in a long log.

    python -m tools.trials seek [--hours 1] [--rate-hz 60] [--seeks 200]

The tool writes a log of laser scans and seeks to random places. A seek ends when the first message from there
could be sent. More than 0.2 s is a violation.
"""

import argparse
import random
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp import Header, Time
from robbie_mp.logs.playback.tape import Tape
from robbie_mp.logs.recording.conversion import NewChannel, converted_log
from robbie_mp.logs.recording.format import ChannelKey, TopicNames
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import LaserScan, schema_text
from tools.trials.harness import Case, TrialSubject
from tools.trials.recordings.intel import is_clean

START_NS = 1_700_000_000_000_000_000
LIMIT_S = 0.2
BEAMS = 360


def write_scans(path: Path, count: int, rate_hz: float) -> None:
    """Write a log with a number of scans, whose noise is like that of a real laser."""
    key = ChannelKey(LaserScan.type_name, LaserScan.version, "", "laser")
    channel = NewChannel(TopicNames().of(key), LaserScan.type_name, schema_text(LaserScan))
    noise = np.random.default_rng(1).normal(0.0, 0.01, (100, BEAMS)).astype(np.float32)
    with converted_log(path, path) as log:
        for number in range(count):
            at_ns = START_NS + round(number / rate_hz * 1e9)
            header = Header(stamp=Time.from_nanoseconds(at_ns), frame_id="laser")
            scan = LaserScan(header=header, range_max=10.0, ranges=np.float32(5.0) + noise[number % 100])
            log.add(channel, key.metadata(), at_ns, scan.encode())


def measure(path: Path, seeks: int) -> dict[str, Any]:
    """Seek to random places, and check the messages found there."""
    chance = random.Random(1)
    took_s, violations = [], []
    began_s = time.perf_counter()
    with open_log(path) as log:
        opened_s = time.perf_counter() - began_s
        tape = Tape(log, log.channels, log.start_ns, log.end_ns)
        for _ in range(seeks):
            to_ns = chance.randint(log.start_ns, log.end_ns)
            began_s = time.perf_counter()
            tape.seek(to_ns)
            took_s.append(time.perf_counter() - began_s)
            if tape.next is None or not to_ns <= tape.next.time_ns < to_ns + 1e9:
                violations.append(f"seeking {to_ns} led to {tape.next and tape.next.time_ns}")
    if max(took_s) > LIMIT_S:
        violations.append(f"a seek took {max(took_s):.3f} s")
    return {
        "log_bytes": path.stat().st_size,
        "open_ms": round(opened_s * 1e3, 1),
        "seek_median_ms": round(statistics.median(took_s) * 1e3, 2),
        "seek_max_ms": round(max(took_s) * 1e3, 2),
        "violations": violations,
    }


def play(case: Case) -> dict[str, Any]:
    """Write a log and seek in it."""
    path, chosen = case.folder / "log.mcap", case.options
    write_scans(path, round(chosen.hours * 3600 * chosen.rate_hz), chosen.rate_hz)
    return measure(path, chosen.seeks)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the log."""
    parser.add_argument("--hours", type=float, default=1.0, help="length of the log")
    parser.add_argument("--rate-hz", type=float, default=60.0, help="rate of scans")
    parser.add_argument("--seeks", type=int, default=200)


SUBJECT = TrialSubject(
    play=play, options=options, is_good=is_clean, seeds=1, seed_makes="nothing: the log is always the same"
)
