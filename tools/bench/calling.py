"""The benchmark `call`: the round trip of a request and its reply, beside one way in the same run."""

from pathlib import Path
from typing import Any

from tools.bench.options import Options
from tools.bench.robbie import MODULES, RobbieContender
from tools.bench.rounds import Series, run_work
from tools.bench.work import Work


class CallingRobbie(RobbieContender):
    """Measures Robbie's calls: the same robot, with a module that calls and one that serves."""

    def __init__(self) -> None:
        super().__init__("robbie-call", "Robbie-MP: call and reply")

    def pair(self, work: Work, suffix: str = "") -> dict[str, dict[str, Any]]:
        """Return the server and the client, as in a profile."""
        file = work.folder / f"work{suffix}.json"
        work.save(file)
        client = {"class": f"{MODULES}:Client", "settings": {"work_file": str(file)}, "ends_run": True}
        return {f"server{suffix}": {"class": f"{MODULES}:Server"}, f"client{suffix}": client}


def call(options: Options) -> list[dict[str, Any]]:
    """Measure 64 bytes one way, and 64 bytes and their reply of 64 bytes, at 1 kHz."""
    work = Work("", Path(), count=options.messages(3000, 500), rate_hz=1000.0, warm_up=100)
    series = options.chosen([Series(RobbieContender()), Series(CallingRobbie())])
    rows = run_work(series, work, options.times(5, 2), options.budget_s)
    title = "64 bytes one way, and there and back, 1 kHz"
    return [
        {"benchmark": "call", "title": title, "kind": "latency", "reference": "robbie", "contenders": rows}
    ]
