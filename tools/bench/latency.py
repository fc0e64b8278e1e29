"""`latency`: a typed message of 64 bytes, 1,000 times a second, from one publisher to one subscriber."""

from pathlib import Path
from typing import Any

from tools.bench.options import Options
from tools.bench.rounds import run_rounds
from tools.bench.work import Work


def run(options: Options) -> list[dict[str, Any]]:
    """Measure; return one result."""
    count, rounds = (500, 2) if options.quick else (4000, 7)
    work = Work("", Path(), count=options.count or count, rate_hz=1000.0, warm_up=100)
    series = run_rounds(options.contenders("floor", "robbie", "others"), work, options.rounds or rounds)
    return [
        {
            "benchmark": "latency",
            "title": "64 bytes, 1 kHz, one publisher, one subscriber",
            "kind": "latency",
            "reference": "robbie",
            "contenders": [one.as_data() for one in series],
        }
    ]
