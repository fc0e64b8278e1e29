"""Crashes by calls, settings, restored state, and what is outside the module."""

from tests.logs.strangers_kinds.kind import Kind

SERVER = """
from parts import Half, Halve
from robbie_mp import CallRefused, Module


class Feeder(Module):
    def setup(self) -> None:
        self.serve(Halve, self.on_halve)

    def on_halve(self, request: Halve) -> Half:
        if request.value > 8:
            raise CallRefused("too large")
        return Half(value=request.value / 2)
"""

CALL_KINDS = [
    Kind(
        "callback of a call",
        "ZeroDivisionError",
        """
        from parts import Half, Halve
        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.value = 8.0

            def tick(self) -> None:
                self.call(Halve(value=self.value), self.on_half)
                self.value -= 1

            def on_half(self, half: Half) -> None:
                self.status = f"{1 / half.value}"  # here
        """,
        feeder=SERVER,
    ),
    Kind(
        "callback of a refused call",
        "AttributeError",
        """
        from parts import Half, Halve
        from robbie_mp import CallError, Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.value = 1.0

            def tick(self) -> None:
                self.value += 1
                self.call(Halve(value=self.value), self.on_half, self.on_error)

            def on_half(self, half: Half) -> None:
                self.status = f"{half.value}"

            def on_error(self, error: CallError) -> None:
                self.status = f"{error.code}"  # here
        """,
        feeder=SERVER,
    ),
    Kind(
        "call that times out",
        "KeyError",
        """
        from parts import Half, Halve
        from robbie_mp import CallError, CallRefused, Module


        class Victim(Module):
            period_s = 0.1

            def setup(self) -> None:
                self.texts = {CallRefused: "refused"}

            def tick(self) -> None:
                self.call(Halve(value=1.0), self.on_half, self.on_error, timeout_s=0.15)

            def on_half(self, half: Half) -> None:
                self.status = f"{half.value}"

            def on_error(self, error: CallError) -> None:
                self.status = self.texts[type(error)]  # here
        """,
        feeder="""
        import time

        from parts import Half, Halve
        from robbie_mp import Module


        class Feeder(Module):
            def setup(self) -> None:
                self.count = 0
                self.serve(Halve, self.on_halve)

            def on_halve(self, request: Halve) -> Half:
                self.count += 1
                if self.count > 3:
                    time.sleep(0.5)
                return Half(value=request.value / 2)
        """,
    ),
    Kind(
        "answering a call",
        "ValueError",
        """
        import math

        from parts import Half, Halve
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.serve(Halve, self.on_halve)

            def on_halve(self, request: Halve) -> Half:
                return Half(value=math.sqrt(request.value))  # here
        """,
        feeder="""
        from parts import Half, Halve
        from robbie_mp import CallError, Module


        class Feeder(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.value = 5.0

            def tick(self) -> None:
                self.value -= 1
                self.call(Halve(value=self.value), self.on_half, self.on_error)

            def on_half(self, half: Half) -> None:
                self.status = f"{half.value}"

            def on_error(self, error: CallError) -> None:
                self.status = f"{error}"
        """,
    ),
    Kind(
        "goal that it serves",
        "IndexError",
        """
        from goals import Arrived, DriveTo, Driven
        from robbie_mp import ActiveGoal, Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.active: ActiveGoal[DriveTo, Driven, Arrived] | None = None
                self.serve_goals(DriveTo, self.on_goal)

            def on_goal(self, active: ActiveGoal[DriveTo, Driven, Arrived]) -> None:
                self.active, self.way = active, [3.0, 2.0, 1.0]

            def tick(self) -> None:
                if self.active is not None and self.active.is_active:
                    self.active.feedback(Driven(left_m=self.way.pop(0)))  # here
        """,
        files={
            "goals.py": """
            from robbie_mp import Feedback, Goal, Result, float64


            class Driven(Feedback, name="strange/action/DriveTo_Feedback"):
                left_m: float64


            class Arrived(Result, name="strange/action/DriveTo_Result"):
                duration_s: float64


            class DriveTo(Goal[Driven, Arrived], name="strange/action/DriveTo_Goal"):
                distance_m: float64
            """
        },
        feeder="""
        from goals import Arrived, DriveTo, Driven
        from robbie_mp import CallError, Module


        class Feeder(Module):
            period_s = 0.2

            def setup(self) -> None:
                self.sent = False

            def tick(self) -> None:
                if not self.sent:
                    self.sent = True
                    self.send_goal(DriveTo(distance_m=3.0), self.on_arrived, self.on_error, self.on_driven)

            def on_driven(self, driven: Driven) -> None:
                self.status = f"{driven.left_m}"

            def on_arrived(self, arrived: Arrived) -> None:
                self.status = "there"

            def on_error(self, error: CallError) -> None:
                self.status = f"{error}"
        """,
    ),
    Kind(
        "result of its goal",
        "ZeroDivisionError",
        """
        from goals import Arrived, DriveTo, Driven
        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.05

            def setup(self) -> None:
                self.driven, self.begun = 0, False

            def tick(self) -> None:
                if not self.begun:
                    self.begun = True
                    self.send_goal(DriveTo(distance_m=2.0), self.on_arrived, on_feedback=self.on_driven)

            def on_driven(self, driven: Driven) -> None:
                self.driven += 1

            def on_arrived(self, arrived: Arrived) -> None:
                self.status = f"{self.driven / arrived.duration_s}"  # here
        """,
        files={
            "goals.py": """
            from robbie_mp import Feedback, Goal, Result, float64


            class Driven(Feedback, name="strange/action/DriveTo_Feedback"):
                left_m: float64


            class Arrived(Result, name="strange/action/DriveTo_Result"):
                duration_s: float64


            class DriveTo(Goal[Driven, Arrived], name="strange/action/DriveTo_Goal"):
                distance_m: float64
            """
        },
        feeder="""
        from goals import Arrived, DriveTo, Driven
        from robbie_mp import ActiveGoal, Module


        class Feeder(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.active: ActiveGoal[DriveTo, Driven, Arrived] | None = None
                self.serve_goals(DriveTo, self.on_goal)

            def on_goal(self, active: ActiveGoal[DriveTo, Driven, Arrived]) -> None:
                self.active, self.left = active, 4

            def tick(self) -> None:
                if self.active is None or not self.active.is_active:
                    return
                self.left -= 1
                self.active.feedback(Driven(left_m=float(self.left)))
                if self.left == 0:
                    self.active.succeed(Arrived(duration_s=0.0))
        """,
    ),
]

SETTING_KINDS = [
    Kind(
        "setting changed, in setting_changed",
        "ZeroDivisionError",
        """
        from robbie_mp import Module, setting


        class Victim(Module):
            rate_hz: float = setting(10.0, "how often", changeable=True)
            period_s = 0.02

            def setup(self) -> None:
                self.step_s = 0.1

            def setting_changed(self, name: str) -> None:
                self.step_s = 1 / self.rate_hz  # here

            def tick(self) -> None:
                self.status = f"{self.step_s}"
        """,
        commands=[["param", "set", "victim.rate_hz", "0"]],
    ),
    Kind(
        "setting changed, used later",
        "IndexError",
        """
        from parts import Number
        from robbie_mp import Module, setting


        class Victim(Module):
            lane: int = setting(1, "which lane", changeable=True)

            def setup(self) -> None:
                self.lanes = ["left", "middle", "right"]
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = self.lanes[self.lane]  # here
        """,
        commands=[["param", "set", "victim.lane", "3"]],
    ),
    Kind(
        "setting of the profile",
        "ValueError",
        """
        from pathlib import Path

        from parts import Number
        from robbie_mp import Module, setting


        class Victim(Module):
            names: list[str] = setting(["a"], "the words that it knows")
            file: Path = setting(Path("words.txt"), "further words")

            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = f"{self.names.index(number.word)} {self.file}"  # here
        """,
        profile="settings: {names: [w0, w1, w2, w3], file: data/words.txt},",
    ),
]

RESTORED_KINDS = [
    Kind(
        "restored state",
        "KeyError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.state = self.restored or {"count": 0, "old": True}
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                count = self.state["count"] + 1
                self.state = {"count": count}
                self.checkpoint(self.state)
                if count == 5:
                    self.state["missing"]
                if count == 12:
                    self.state["old"]  # here
        """,
        crashes=2,
    ),
    Kind(
        "restored state, in setup",
        "ValueError",
        """
        import numpy as np
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.values = np.zeros(3)
                if self.restored is not None:
                    self.values[:] = self.restored["values"]  # here
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.checkpoint({"values": np.arange(number.value + 1)})
                if number.value == 8:
                    raise RuntimeError("the first death")
        """,
        crashes=2,
    ),
    Kind(
        "checkpoint in mid-run, long history",
        "KeyError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.total = self.restored or 0
                self.names = {0: "a"}
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.total += 1
                if self.total % 1000 == 0:
                    self.checkpoint(self.total)
                if self.total > 8010:
                    self.names[self.total - 8010]  # here
        """,
        feeder="""
        from parts import Number
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.005

            def tick(self) -> None:
                for _ in range(20):
                    self.publish(Number(value=1.0, word="x" * 600))
        """,
    ),
    Kind(
        "number of its process",
        "RuntimeError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                if self.incarnation == 2:
                    raise RuntimeError("a second process is one too many")  # here
                if number.value == 4:
                    raise ValueError("the first death")
        """,
        crashes=2,
    ),
]

STATE_KINDS = CALL_KINDS + SETTING_KINDS + RESTORED_KINDS
