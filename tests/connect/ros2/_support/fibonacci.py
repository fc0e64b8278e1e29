"""A module that serves goals of ROS's own example action."""

import numpy as np

from robbie_mp import ActiveGoal, Array, CallRefused, Feedback, Goal, Module, Result, int32


class Grown(Feedback, name="test_msgs/action/Fibonacci_Feedback"):
    sequence: Array[int32]


class Sequence(Result, name="test_msgs/action/Fibonacci_Result"):
    sequence: Array[int32]


class Fibonacci(Goal[Grown, Sequence], name="test_msgs/action/Fibonacci_Goal"):
    order: int32


Active = ActiveGoal[Fibonacci, Grown, Sequence]
ENDLESS, HOPELESS = 1000, 13


class Rabbits(Module):
    """Adds one number to each sequence per tick: of order 13 it gives up, and of order 1000 it has no end."""

    period_s = 0.05

    def setup(self) -> None:
        self.work: dict[Active, list[int]] = {}
        self.serve_goals(Fibonacci, self.on_goal)

    def on_goal(self, active: Active) -> None:
        if active.goal.order < 0:
            raise CallRefused("there is no such number")
        self.work[active] = [0, 1]

    def tick(self) -> None:
        self.work = {active: numbers for active, numbers in self.work.items() if active.is_active}
        self.status = f"{len(self.work)} at work"
        for active, numbers in self.work.items():
            numbers.append((numbers[-1] + numbers[-2]) % 1_000_000)
            active.feedback(Grown(sequence=np.array(numbers[-20:], np.int32)))
            if active.goal.order == HOPELESS and len(numbers) == HOPELESS:
                active.abort("it brings bad luck")
            elif active.goal.order != ENDLESS and len(numbers) >= active.goal.order + 1:
                active.succeed(Sequence(sequence=np.array(numbers, np.int32)))
