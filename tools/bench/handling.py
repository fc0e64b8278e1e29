"""The cost of a message within one process: construct, encode, decode."""

import timeit
from collections.abc import Callable
from typing import Any

from robbie_mp.messages import Time, Vector3
from tools.bench.options import Options
from tools.bench.robbie_modules import Probe

CALLS = 20_000
BATCHES = 7
"""Of which the fastest counts: the others were disturbed."""


def handling(options: Options) -> list[dict[str, Any]]:
    """Time each step in a tight loop, with all its data in the processor's caches."""
    probe = Probe(number=1, stamp_ns=2, x=1.0, y=2.0, z=3.0, roll=4.0, pitch=5.0, yaw=6.0)
    data = probe.encode()
    space = memoryview(bytearray(len(data)))
    steps: dict[str, Callable[[], object]] = {
        "construct 64 B, all 8 fields given": lambda: Probe(
            number=1, stamp_ns=2, x=1.0, y=2.0, z=3.0, roll=4.0, pitch=5.0, yaw=6.0
        ),
        "construct 64 B, 6 defaults": lambda: Probe(number=1, stamp_ns=2),
        "construct Vector3": lambda: Vector3(x=1.0, y=2.0, z=3.0),
        "construct Time": lambda: Time(sec=1, nanosec=2),
        "encode 64 B": lambda: probe.encode_into(space),
        "decode 64 B": lambda: Probe.decode(data),
    }
    calls = CALLS // 10 if options.quick else CALLS
    rows = [
        {
            "name": name,
            "title": name,
            "version": "",
            "how": "",
            "trouble": "",
            "rounds": [0],
            "us": [min(timeit.repeat(step, number=calls, repeat=BATCHES)) / calls * 1e6],
        }
        for name, step in steps.items()
    ]
    return [
        {
            "benchmark": "handling",
            "title": "one step in a tight loop, one process",
            "kind": "handling",
            "contenders": rows,
        }
    ]
