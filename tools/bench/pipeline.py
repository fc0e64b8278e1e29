"""The benchmark `pipeline`: from a camera's pictures to the base, through three modules."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tools.bench import record
from tools.bench.contender import PeerContender, Trouble, WorkResult, outcome, wait_for_end, work_folder
from tools.bench.messages import IMAGE_BYTES, IMAGE_HZ
from tools.bench.options import IN_PLACE, Options, peer
from tools.bench.processes import family, measure_cpu_ns
from tools.bench.robbie import LIMIT_S, MODULES, RobbieContender
from tools.bench.rounds import Series, figures, run_rounds
from tools.bench.work import Work

Result = dict[str, Any]

STAGES = ("detector", "tracker", "planner")
PEERS = ("iceoryx2", "dora", "rclpy")
WARM_UP = 10
MEASURED_PART = 0.8
"""Part of the messages' time for which processor time is measured."""
CONNECT_LIMIT_S = 40.0
LOOK_S = 0.02


class PipelineRobbie(RobbieContender):
    """Measures Robbie.

    Args:
        is_watched: whether there are also a logger, which leaves the pictures out, and the operator's page.
    """

    def __init__(self, is_watched: bool = False):
        super().__init__(*(("robbie-watched", "Robbie-MP, logger and page") if is_watched else ()))
        self._is_watched = is_watched

    def pair(self, work: Work, suffix: str = "") -> dict[str, dict[str, Any]]:
        """Return the modules, the last of the chain first, as in a profile."""
        file = work.folder / f"work{suffix}.json"
        work.save(file)
        settings = {"work_file": str(file)}
        watching: dict[str, dict[str, Any]] = {
            "logger": {
                "class": "robbie_mp.logs.message_logger:MessageLogger",
                "settings": {"folder": str(work.folder / "log"), "exclude": ["bench_msgs/msg/Picture"]},
            },
            "operator": {"class": "robbie_mp.station:OperatorStation", "settings": {"port": 0}},
        }
        stages = {
            name: {"class": f"{MODULES}:PipelineStage", "settings": {**settings, "index": index}}
            for index, name in enumerate(STAGES)
        }
        return {
            **(watching if self._is_watched else {}),
            "base": {"class": f"{MODULES}:PipelineBase", "settings": settings, "ends_run": True},
            **dict(reversed(stages.items())),
            "camera": {"class": f"{MODULES}:PipelineCamera", "settings": settings},
        }


@dataclass(frozen=True)
class PipelineOutcome:
    """What one run gave: the messages at the base, and the processor time of all processes."""

    result: WorkResult
    cpu_percent: float


def pipeline(options: Options) -> list[Result]:
    """Measure the age of pictures at the base, and the processor time of all processes."""
    count = options.messages(300, 30)
    work = Work("", Path(), IMAGE_BYTES, count, IMAGE_HZ, warm_up=WARM_UP, stages=len(STAGES))
    series = [
        Series(PipelineRobbie(), {"in_place": True}, IN_PLACE),
        Series(PipelineRobbie(is_watched=True), {"in_place": True}, IN_PLACE),
        Series(PipelineRobbie()),
        Series(peer("iceoryx2"), {"in_place": True}, IN_PLACE),
        *(Series(peer(name)) for name in PEERS),
    ]

    def run(one: Series) -> PipelineOutcome:
        return _run(one.contender, replace(work, **one.changes))

    chosen = options.chosen(series)
    run_rounds(chosen, run, options.times(3, 1), options.budget_s, options.watched)
    rows = [
        one.describe()
        | (figures([outcome.result for outcome in one.outcomes]) if one.outcomes else {})
        | {"cpu_percent": [outcome.cpu_percent for outcome in one.outcomes]}
        for one in chosen
    ]
    title = f"1080p at {IMAGE_HZ:g} Hz: camera, {', '.join(STAGES)}, base"
    return [{"benchmark": "pipeline", "title": title, "kind": "pipeline", "contenders": rows}]


def _run(contender: Any, work: Work) -> PipelineOutcome:
    with work_folder() as (topic, folder):
        here = work.at(topic, folder)
        if isinstance(contender, PipelineRobbie):
            with contender.robot(folder, contender.pair(here)) as robot:
                cpu_percent = _cpu_percent(here, robot.supervisor.pid)
                robot.wait_for_end(LIMIT_S)
        else:
            assert isinstance(contender, PeerContender)
            try:
                with contender.started(here) as processes:
                    cpu_percent = _cpu_percent(here, *(process.pid for process in processes))
                    wait_for_end(processes, LIMIT_S)
            finally:
                contender.peer.clean(here)
        return PipelineOutcome(outcome(here), cpu_percent)


def _cpu_percent(work: Work, *pids: int) -> float:
    """Wait for the first message, and measure while most of the others are sent; % of one processor."""
    base = record.map_subscriber(work, 0)
    deadline_s = time.monotonic() + CONNECT_LIMIT_S
    while not base[record.MEASURED]:
        if time.monotonic() > deadline_s:
            raise Trouble(f"no message has come through within {CONNECT_LIMIT_S:g} s")
        time.sleep(LOOK_S)
    window_s = MEASURED_PART * work.count / work.rate_hz
    return measure_cpu_ns(family(*pids), window_s) / 1e7 / window_s
