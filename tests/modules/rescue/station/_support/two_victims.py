"""Copied into the workspace of tests: a robot that asks about two victims at the same time."""

from robbie_mp import Module
from robbie_mp.messages import String
from robbie_robots.modules.rescue.messages import AnswerVictim, VictimAnswered, VictimFound


class TwoVictims(Module):
    """Withdraws the named questions, and records the answers."""

    period_s = 0.05

    def setup(self) -> None:
        self.file = (self.output_directory / "told.txt").open("a")
        self.asked = {3: True, 8: True}
        self.ticks = 0
        self.is_silent = False
        self.subscribe(String, self.on_order, topic="orders")
        self.serve(AnswerVictim, self.on_answer)

    def on_order(self, order: String) -> None:
        """Ask about these victims from now on; without any, publish nothing."""
        self.is_silent = not order.data
        self.asked = {number: str(number) in order.data.split() for number in self.asked}

    def on_answer(self, answer: AnswerVictim) -> VictimAnswered:
        print("answer", answer.id, answer.answer, file=self.file, flush=True)
        return VictimAnswered()

    def tick(self) -> None:
        if self.is_silent:
            return
        self.ticks += 1
        number = (3, 8)[self.ticks % 2]
        state = VictimFound.ASKED if self.asked[number] else VictimFound.SUSPECTED
        self.publish(VictimFound(id=number, name=f"tag {number}", state=state, answer_within_s=900.0))

    def teardown(self) -> None:
        self.file.close()
