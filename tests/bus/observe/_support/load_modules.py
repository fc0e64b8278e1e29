"""A known load: these modules keep their own counters, for comparison with others."""

import itertools
import json
import time

import numpy as np

from robbie_mp import Module, setting
from robbie_mp.bus.transport.histogram import WorkFigures
from robbie_mp.messages import DriveCommand, LaserScan, SystemProfile

RECORDED: dict[int, list[tuple[int, int]]] = {}
"""The exact numbers that were put into each pair of histograms."""
_record = WorkFigures.record


def _record_and_remember(figures: WorkFigures, waited_ns: int, took_ns: int) -> None:
    _record(figures, waited_ns, took_ns)
    RECORDED.setdefault(figures._at, []).append((waited_ns, took_ns))


WorkFigures.record = _record_and_remember  # type: ignore[method-assign,assignment]


class Bookkeeper(Module):
    """Writes its counters to a file when it is stopped."""

    def books(self) -> dict[str, object]:
        return {}

    def teardown(self) -> None:
        recorded = {str(at): pairs for at, pairs in RECORDED.items()}
        (self.output_directory / f"{self.name}.json").write_text(
            json.dumps({"recorded": recorded, **self.books()})
        )


class Talker(Bookkeeper):
    """Publishes scans in bursts until there is a file, and then says how many they were."""

    period_s = 0.05
    burst: int = setting(10, "scans in each tick")

    def setup(self) -> None:
        self.sent: list[tuple[float, int]] = [(time.time(), 0)]

    def tick(self) -> None:
        sent = self.sent[-1][1]
        if (self.output_directory / "enough").exists():
            self.status = f"sent {sent}"
        else:
            for _ in range(self.burst):
                self.publish(LaserScan(ranges=np.zeros(64, np.float32)), topic=self.name)
            self.sent.append((time.time(), sent + self.burst))

    def books(self) -> dict[str, object]:
        return {"sent": self.sent}


class Hearer(Bookkeeper):
    """Handles the scans of one talker; some take longer by a known time."""

    topic: str = setting("", "topic of the scans that it handles")
    work_s: float = setting(0.0, "time that every handler takes")
    keep: int = setting(0, "number of scans that it keeps")

    def setup(self) -> None:
        self.kept: list[np.ndarray] = []
        self.took_ns: list[int] = []
        self.stamps_ns: list[int] = []
        self.numbers = itertools.count(1)
        self.subscribe(LaserScan, self.on_scan, topic=self.topic)
        self.show_state("LISTEN", "ear")

    def on_scan(self, scan: LaserScan) -> None:
        begun_ns = time.monotonic_ns()
        number = next(self.numbers)
        self.stamps_ns.append(self.envelope.published_ns)
        if self.work_s or number % 50 == 0:
            time.sleep(self.work_s or 0.005)
        self.kept = [*self.kept, scan.ranges][-self.keep :] if self.keep else []
        self.status = f"{number} scans"
        self.took_ns.append(time.monotonic_ns() - begun_ns)

    def books(self) -> dict[str, object]:
        return {"took_ns": self.took_ns, "stamps_ns": self.stamps_ns}


class Reporter(Bookkeeper):
    """Records the profiler's messages."""

    def setup(self) -> None:
        self.said: list[dict[str, object]] = []
        self.subscribe(SystemProfile, self.on_profile)

    def on_profile(self, profile: SystemProfile) -> None:
        self.said.append(
            {
                "interval_s": profile.interval_s,
                "channels": {
                    one.topic: {"messages": one.messages, "hz": one.hz}
                    for one in profile.channels
                    if one.message_type == LaserScan.type_name
                },
                "modules": {
                    one.name: {
                        "pid": one.pid,
                        "state": one.state,
                        "in_hz": one.in_hz,
                        "p99": one.handler_p99_s,
                    }
                    for one in profile.modules
                },
            }
        )

    def books(self) -> dict[str, object]:
        return {"said": self.said}


class Ticker(Module):
    """Publishes one message after another, slowly, until the end."""

    period_s = 0.05

    def tick(self) -> None:
        self.publish(DriveCommand())


class Hanger(Module):
    """Handles them until there is a file; then it hangs."""

    def setup(self) -> None:
        self.subscribe(DriveCommand, self.on_command)

    def on_command(self, _command: DriveCommand) -> None:
        if (self.output_directory / "hang").exists():
            time.sleep(600)
