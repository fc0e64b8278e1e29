"""One campaign from the first process to the verdict."""

import contextlib
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.run.supervisor.connection_watch import CHECK_PERIOD_S
from tools.kill_campaign import calls, latched, neighbours, traces
from tools.kill_campaign.attack import Attack, Signalled
from tools.kill_campaign.frozen_log import FrozenLog, log_disk
from tools.kill_campaign.modules import PAUSE_FILE, QUIET
from tools.kill_campaign.neighbours import measure_neighbours
from tools.kill_campaign.profile import RESTART, publishers, roles, write_workspace
from tools.kill_campaign.records import ModuleRecord
from tools.kill_campaign.recovery import recovery_times
from tools.kill_campaign.traces import Traces
from tools.kill_campaign.verdict import causes, judge, read_records
from tools.kill_campaign.visitor import Visitors
from tools.robot import Robot

CALM_S = 1.0
"""Time without kills before the pause, so that all modules handle their last messages."""
REST_LIMIT_S = 120.0
OTHER_PARTS = calls.PARTS | latched.PARTS
"""Modules with their own journals and verdicts."""
RESTART_SAID = re.compile(r"^(\S+): BACKOFF \((.*), again in [0-9.]+ s\)$", re.MULTILINE)


@dataclass(frozen=True)
class AttackPlan:
    """The plan of attack on a robot.

    Attributes:
        kills: processes to kill.
        minutes: end after this time, even with fewer kills.
        mean_pause_s: mean time between attacks.
        longest_stop_s: maximum time for which a process is stopped.
        spared: processes that are neither killed nor stopped.
        rounds_with_camera: how often to measure what a stopped and a hoarding viewer of a camera cost a
            healthy one; 0: without a camera.
        freeze_log: freeze the logs' disk from time to time.
        others: further modules, as in a profile.
    """

    kills: int
    seed: int
    minutes: float = float("inf")
    mean_pause_s: float = 0.3
    longest_stop_s: float = 10.0
    spared: frozenset[str] = frozenset()
    rounds_with_camera: int = 0
    freeze_log: bool = False
    others: Mapping[str, dict[str, Any]] = field(default_factory=dict)


def run_campaign(
    plan: AttackPlan, folder: Path, each_second: Callable[[Robot], None] | None = None
) -> dict[str, Any]:
    """Run a campaign in an empty folder and return its report. Its `violations` must be empty.

    Raises:
        RobotTrouble: the robot does not start, come to rest, or end.
    """
    settings = roles(overloaded=True, camera=plan.rounds_with_camera > 0)
    others = {name: part | {"restart": RESTART} for name, part in OTHER_PARTS.items()}
    write_workspace(folder / "workspace", settings, others | dict(plan.others))
    with contextlib.ExitStack() as stack:
        disk = stack.enter_context(log_disk(folder / "output")) if plan.freeze_log else None
        robot = Robot(folder, folder / "workspace", "campaign")
        stack.callback(robot.close)
        frozen_log = FrozenLog(disk, robot, plan.seed) if disk else None
        visitors = Visitors(robot, plan.seed)
        stack.callback(visitors.finish)
        names = [*settings, *OTHER_PARTS]
        return _run(plan, robot, names, publishers(settings), each_second, frozen_log, visitors)


def _run(
    plan: AttackPlan,
    robot: Robot,
    names: list[str],
    sending: list[str],
    each_second: Callable[[Robot], None] | None,
    frozen_log: FrozenLog | None,
    visitors: Visitors,
) -> dict[str, Any]:
    robot.wait_until_running()
    robot.wait_for(lambda: _all_work(robot, sending), "not every module publishes")
    before = Traces.of(robot.run_id, _pids(robot))
    beside = measure_neighbours(robot, plan.rounds_with_camera) if plan.rounds_with_camera else None
    attack = Attack(robot, plan.seed, plan.mean_pause_s, plan.longest_stop_s, plan.spared, each_second)
    began_s = time.monotonic()
    attack.each_look = [visitors.look, *([frozen_log.look] if frozen_log else [])]
    attack.run(plan.kills, began_s + 60 * plan.minutes)
    attack.finish()
    visitors.finish()
    if frozen_log:
        frozen_log.finish()
    duration_s = time.monotonic() - began_s
    robot.wait_for(robot.all_running, "not every process is RUNNING again")
    time.sleep(CALM_S)
    rest_s = _come_to_rest(robot, names)
    visitors.last_visit()
    time.sleep(CHECK_PERIOD_S + CALM_S)  # until the supervisor has unmapped the memory of the tools
    _come_to_rest(robot, names)
    figures = robot.figures()
    after = _traces_without_capsules(robot, before, figures)
    assert robot.observer is not None
    channels = robot.observer.channels()
    summary = robot.stop()
    records = read_records(robot.output, [name for name in names if name not in OTHER_PARTS])
    verdict = judge(records, figures, channels)
    of_calls, call_violations = calls.judge_calls(robot.output)
    of_latched, latched_violations = latched.judge_latched(robot.output)
    verdict.violations += call_violations + latched_violations
    verdict.violations += traces.violations(before, after, robot.run_id, figures)
    verdict.violations += _deaths(attack, figures)
    verdict.violations += neighbours.violations(beside) if beside else []
    verdict.violations += frozen_log.violations(attack.kills) if frozen_log else []
    verdict.violations += _end(robot, summary, figures, names)
    return {
        "seed": plan.seed,
        "modules": len(names),
        "duration_s": round(duration_s, 1),
        "kills": len(attack.kills),
        "kills_by_kind": attack.count(),
        "restarts": {name: module.restarts for name, module in figures.items()},
        "other_ends": _other_ends(robot.said()),
        "messages": verdict.totals(),
        "bytes": sum(channel.bytes for channel in channels),
        "deliveries": causes(figures),
        "calls": of_calls,
        "latched": of_latched | {"kills of the tool": visitors.kills},
        "neighbours": beside or {},
        "recovery": recovery_times(attack.kills, records),
        "log_disk": _of_log_disk(frozen_log, attack.kills, records) if frozen_log else {},
        "trace_entries_dropped": sum(module["trace_entries_dropped"] for module in summary["modules"]),
        "rest_s": round(rest_s, 2),
        "names": {"before": traces.kinds(before), "after": traces.kinds(after)},
        "descriptors": {
            name: [len(before.descriptors[name]), len(opened)] for name, opened in after.descriptors.items()
        },
        "violations": verdict.violations,
    }


def _of_log_disk(
    frozen_log: FrozenLog, kills: list[Signalled], records: dict[str, ModuleRecord]
) -> dict[str, Any]:
    return frozen_log.report(kills, recovery_times(frozen_log.during(kills), records))


def _all_work(robot: Robot, sending: list[str]) -> bool:
    figures = robot.figures()
    return all(figures[name].published > 10 for name in sending)


def _pids(robot: Robot) -> dict[str, int]:
    return {"supervisor": robot.supervisor.pid} | {name: m.pid for name, m in robot.figures().items()}


def _traces_without_capsules(robot: Robot, before: Traces, figures: Mapping[str, ModuleFigures]) -> Traces:
    """Return what is left when all capsules are written: until then the supervisor keeps what they need.

    It writes one after another, each of which takes half a second of a processor.
    """
    deadline_s = time.monotonic() + REST_LIMIT_S
    while True:
        after = Traces.of(robot.run_id, _pids(robot))
        if not traces.violations(before, after, robot.run_id, figures) or time.monotonic() > deadline_s:
            return after
        time.sleep(CALM_S)


def _come_to_rest(robot: Robot, names: list[str]) -> float:
    """Pause all modules, and wait until none of them waits for, handles or holds a message."""
    (robot.output / PAUSE_FILE).touch()
    return robot.wait_for(lambda: _rests(robot, names), "messages are still held or waited for", REST_LIMIT_S)


def _rests(robot: Robot, names: list[str]) -> bool:
    figures = robot.figures()
    modules = [figures[name] for name in names]
    return (
        all(module.status == QUIET and not module.waiting and not module.pinned for module in modules)
        and all(not books.waiting for module in modules for books in module.subscriptions)
        and traces.rows_used(robot.run_id) == latched.ROWS_AT_REST
    )


def _deaths(attack: Attack, figures: Mapping[str, ModuleFigures]) -> list[str]:
    """Check that the campaign caused every restart. A stopped process may also count as hung."""
    found = []
    for name, module in figures.items():
        killed = {signalled.incarnation for signalled in attack.kills if signalled.name == name}
        stopped = {signalled.incarnation for signalled in attack.stops if signalled.name == name}
        if not len(killed) <= module.restarts <= len(killed | stopped):
            found.append(f"{name} was restarted {module.restarts} times, but killed {len(killed)} times")
    return found


def _other_ends(said: str) -> dict[str, int]:
    """Return the restarts not caused by SIGKILL, by name and reason, from the supervisor's log."""
    ends = RESTART_SAID.findall(said)
    return dict(Counter(f"{name}: {reason}" for name, reason in ends if reason != "killed by SIGKILL"))


def _end(
    robot: Robot, summary: dict[str, Any], figures: Mapping[str, ModuleFigures], names: list[str]
) -> list[str]:
    """Check that the summary matches the figures seen before the end, and that nothing is left behind."""
    code, reason = summary["exit_code"], summary["reason"]
    found = [f"the run ended with {code}: {reason}"] if code else []
    for module in summary["modules"]:
        if module["name"] in names:
            books = [entry["routed"] for entry in module["subscriptions"]]
            if books != [entry.routed for entry in figures[module["name"]].subscriptions]:
                found.append(f"the summary's books of {module['name']} differ from those before the end")
    left = [path.name for path in SHARED_MEMORY.iterdir() if robot.run_id in path.name]
    return found + [f"{SHARED_MEMORY}/{name} is left after the end" for name in sorted(left)]
