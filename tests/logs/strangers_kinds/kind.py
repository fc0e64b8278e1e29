"""A kind of crash: a module's code, what feeds it, and what should end it where."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import dedent

CHANCE = "a capsule does not hold"
"""What replay says where the module depends on what Robbie-MP does not give it."""
HERE = "# here"
"""Marks the line of the crash."""

PARTS = '''
"""Messages that several kinds use."""

from robbie_mp import DEFAULT, Message, Module, Reply, Request, float64


class Number(Message, name="strangers_msgs/msg/Number", version=1):
    """A number, and a word."""

    value: float64 = DEFAULT
    word: str = DEFAULT


class Other(Message, name="strangers_msgs/msg/Other", version=1):
    """Another number."""

    value: float64 = DEFAULT


class Half(Reply, name="strangers_msgs/srv/Halve_Response"):
    """Half of a number."""

    value: float64


class Halve(Request[Half], name="strangers_msgs/srv/Halve_Request"):
    """Asks for half of a number."""

    value: float64
'''

COUNTER = """
from parts import Number
from robbie_mp import Module


class Feeder(Module):
    period_s = 0.005

    def setup(self) -> None:
        self.count = 0

    def tick(self) -> None:
        self.publish(Number(value=float(self.count), word=f"w{self.count % 7}"))
        self.count += 1
"""
"""Publishes 0, 1, 2, …"""


@dataclass(frozen=True)
class Kind:
    """A module that crashes in its own way.

    Attributes:
        name: what kind of crash it is.
        error: the exception's class, or a word of the reason, such as SIGSEGV.
        victim: the code of victim.py with a class Victim; the line of the crash ends with `# here`.
        feeder: the code of feeder.py with a class Feeder, which gives the victim what it crashes of.
        files: further files of the workspace.
        profile: further keys of the victim in the profile, in YAML's flow style.
        commands: arguments of `robbie`, run as soon as the victim is RUNNING.
        environment: further variables, only of the run.
        crashes: how often it has to crash; the last capsule counts.
        why_not: what replay says if this kind cannot be replayed (a regular expression); empty: it can.
    """

    name: str
    error: str
    victim: str
    feeder: str = COUNTER
    files: Mapping[str, str] = field(default_factory=dict)
    profile: str = ""
    commands: Sequence[Sequence[str]] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    crashes: int = 1
    why_not: str = ""

    def workspace(self) -> dict[str, str]:
        """Return the files of a workspace with this robot, by their names."""
        victim = (
            f"restart: {{max_restarts: {self.crashes - 1}, retry_s: 0}}, essential: true, "
            f"memory: {{history_bytes: 4M{self.profile.partition('memory:')[2]}}}"
        )
        further = self.profile.partition("memory:")[0]
        profile = f"""
            modules:
              feeder: {{class: "feeder:Feeder"}}
              victim: {{class: "victim:Victim", {further} {victim}}}
            spares: {{count: 0}}
            black_box: false
            """
        files = {"parts.py": PARTS, "victim.py": self.victim, "feeder.py": self.feeder, **self.files}
        files["profiles/robot.yaml"] = profile
        return {name: dedent(text).lstrip("\n") for name, text in files.items()}

    def place(self) -> str:
        """Return where it crashes, such as `victim.py:12`; empty: nobody can say."""
        for name, text in self.workspace().items():
            for number, line in enumerate(text.splitlines(), 1):
                if line.endswith(HERE):
                    return f"{name}:{number}"
        return ""
