"""The part of the campaign's robot that calls: two clients, one server, and the verdict on their journals.

Further lines of the journals (see `tools.journal`):

    C number t                  the client is about to make this call, or with `g` to send this goal
    F number t                  feedback about a goal has come
    D number outcome t          it has ended: `reply`, or the name of the error
    H client call number t      the server's handler was entered
    M client call t             the server, restarted, goes on with this goal
"""

import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robbie_mp import (
    ActiveGoal,
    CallError,
    Feedback,
    Goal,
    Module,
    Reply,
    Request,
    Result,
    SentGoal,
    setting,
    uint64,
)
from tools.journal import Journal, read_journal
from tools.kill_campaign.modules import PAUSE_FILE, QUIET

STEPS = 5
CANCEL_EVERY = 53
SERVER = "callee"
CLIENTS = ("caller", "caller_back")
PARTS: dict[str, dict[str, Any]] = {
    SERVER: {"class": "tools.kill_campaign.calls:Callee"},
    **{name: {"class": "tools.kill_campaign.calls:Caller"} for name in CLIENTS},
}
OUTCOMES = {"reply", "ServerDied", "CallLost", "CallTimedOut", "GoalCancelled"}
"""How calls may end in a campaign; a server that is killed comes back, so NoServer is wrong."""


class Squared(Reply, name="campaign_msgs/srv/Square_Response"):
    """The square of a number."""

    number: uint64


class Square(Request[Squared], name="campaign_msgs/srv/Square_Request"):
    """A number to be squared."""

    number: uint64


class Climbed(Feedback, name="campaign_msgs/action/Climb_Feedback"):
    """The steps done so far."""

    steps: uint64


class Top(Result, name="campaign_msgs/action/Climb_Result"):
    """The number of steps."""

    steps: uint64


class Climb(Goal[Climbed, Top], name="campaign_msgs/action/Climb_Goal"):
    """Steps to be done."""

    steps: uint64


class Callee(Module):
    """Serves, and journals what it handles; it takes a little time, so that it dies in its handler, too.

    It works on all goals at once, one step in each tick, and goes on with them after a restart.
    """

    handle_s: float = setting(0.002, "duration of a handler", minimum=0.0)
    period_s = 0.1

    def setup(self) -> None:
        """Journal a new incarnation, and serve."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.journal.note("S", 0)
        self.climbing: dict[ActiveGoal[Climb, Climbed, Top], int] = {}
        self.serve(Square, self.on_square)
        self.serve_goals(Climb, self.on_climb)
        for memory, steps in self.restored or ():
            active = self.resume_goal(Climb, memory)
            self.journal.note("M", active.client, active.goal.call)
            self.climbing[active] = steps

    def on_square(self, request: Square) -> Squared:
        """Journal a request."""
        self.journal.note("H", self.envelope.sender, request.call, request.number)
        time.sleep(self.handle_s)
        return Squared(number=request.number**2)

    def on_climb(self, active: ActiveGoal[Climb, Climbed, Top]) -> None:
        """Journal a goal, and begin."""
        self.journal.note("H", active.client, active.goal.call, f"g{active.goal.steps}")
        self.climbing[active] = 0
        self.keep()

    def keep(self) -> None:
        """Keep the goals for the next process."""
        self.checkpoint([[active.memory, steps] for active, steps in self.climbing.items()])

    def tick(self) -> None:
        """Do one step of each goal; say when nothing is outstanding."""
        self.climbing = {active: steps + 1 for active, steps in self.climbing.items() if active.is_active}
        for active, steps in self.climbing.items():
            active.feedback(Climbed(steps=steps))
            if steps >= active.goal.steps:
                active.succeed(Top(steps=steps))
        self.keep()
        is_paused = (self.output_directory / PAUSE_FILE).exists()
        self.status = f"paused, {self.outstanding} outstanding" if is_paused else "serves"


class Caller(Module):
    """Calls in each tick, and journals each call and its end."""

    period_s: float = setting(0.02, "time between calls", minimum=0.001)
    timeout_s: float = setting(20.0, "timeout of calls", minimum=0.1)
    limit: int = setting(100, "calls that may wait", minimum=1)

    def setup(self) -> None:
        """Journal a new incarnation."""
        self.life = (self.restored or 0) + 1
        self.checkpoint(self.life)
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.journal.note("S", self.life)
        self.number = self.waiting = 0
        self.goal: SentGoal | None = None

    def tick(self) -> None:
        """Call, unless paused."""
        if (self.output_directory / PAUSE_FILE).exists():
            self.status = f"{self.waiting} calls wait" if self.waiting else self._quiet()
            return
        self.status = f"incarnation {self.life}, {self.number} calls"
        if self.waiting >= self.limit:
            return
        self.number += 1
        self.waiting += 1
        number = self.number
        self.journal.note("C", number)
        self.call(
            Square(number=number),
            lambda reply: self._end(number, "reply" if reply.number == number**2 else "wrong"),
            lambda error: self._fail(number, error),
            timeout_s=self.timeout_s,
        )
        if self.goal is None or not self.goal.is_active:
            self.goal = self._climb(f"g{number}")
        elif number % CANCEL_EVERY == 0:
            self.goal.cancel("another one comes")

    def _climb(self, name: str) -> SentGoal:
        """Send a goal, which ends soon."""
        self.waiting += 1
        self.journal.note("C", name)
        return self.send_goal(
            Climb(steps=STEPS),
            lambda top: self._end(name, "reply" if top.steps == STEPS else "wrong"),
            lambda error: self._fail(name, error),
            lambda _: self.journal.note("F", name),
        )

    def _quiet(self) -> str:
        return QUIET if not self.outstanding else f"paused, {self.outstanding} outstanding"

    def _fail(self, number: int | str, error: CallError) -> None:
        self._end(number, type(error).__name__)

    def _end(self, number: int | str, outcome: str) -> None:
        self.waiting -= 1
        self.journal.note("D", number, outcome)


def judge_calls(folder: Path) -> tuple[dict[str, int], list[str]]:
    """Judge the journals of a robot at rest.

    Returns:
        The number of calls by outcome, and the violations: a call that ended twice, or not although its
        client lived; a reply that does not belong to its call; feedback after the end of a goal; a request
        that a handler got twice.
    """
    outcomes: Counter[str] = Counter()
    violations: list[str] = []
    for name in CLIENTS:
        violations += _judge_client(name, folder / f"{name}.journal", outcomes)
    handled = Counter(
        (client, call)
        for kind, *words in read_journal(folder / f"{SERVER}.journal")
        if kind == "H"
        for client, call in [words[:2]]
    )
    violations += [f"{SERVER} got call {call} {times} times" for call, times in handled.items() if times > 1]
    outcomes["handled"] = len(handled)
    outcomes["goals resumed"] = sum(kind == "M" for kind, *_ in read_journal(folder / f"{SERVER}.journal"))
    return dict(outcomes), violations


def _judge_client(name: str, path: Path, outcomes: Counter[str]) -> Iterator[str]:
    waiting: set[str] = set()
    incarnation = ""
    for kind, *words in read_journal(path):
        if kind == "S":
            outcomes["cut off by the death of the client"] += len(waiting)
            waiting, incarnation = set(), words[0]
        elif kind == "C":
            waiting.add(words[0])
        elif kind == "F":
            outcomes["feedback"] += 1
            if words[0] not in waiting:
                yield f"{name} {incarnation}: feedback about {words[0]}, which has ended or was never sent"
        elif words[0] not in waiting:
            yield f"{name} {incarnation}: call {words[0]} ended twice, or was never made"
        else:
            waiting.remove(words[0])
            outcomes["goal reached" if words[0][0] == "g" and words[1] == "reply" else words[1]] += 1
            if words[1] not in OUTCOMES:
                yield f"{name} {incarnation}: call {words[0]} ended with {words[1]}"
    for number in sorted(waiting):
        yield f"{name} {incarnation}: call {number} has no end"
