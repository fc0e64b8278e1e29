"""The question whether something is a victim. It has a place of its own in every layout, and covers none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from robbie_mp.station.watch.latest import silence
from robbie_robots.modules.rescue.messages import AnswerVictim

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_robots.modules.rescue.station.victim_watch import KnownVictim, VictimWatch

ANSWERS = (
    ("Yes", AnswerVictim.YES, "#2e7d32"),
    ("No", AnswerVictim.NO, "#c62828"),
    ("Later", AnswerVictim.LATER, "#424242"),
)
STYLE = Path(__file__).parent / "victim_question.css"
MAX_QUESTIONS = 8
"""Maximum number of questions that a page has at a time. It shows one after the other."""
SILENT_AFTER_S = 10.0
"""Maximum time between two messages of a robot about an open question."""


class QuestionCard(Element, component="victim_question.js"):
    """Shows one question until the robot withdraws it; an answer names the victim that was shown."""

    def __init__(self, *, can_answer: bool):
        super().__init__()
        self._props["answers"] = ANSWERS if can_answer else ()
        self._props["questions"] = []

    def show(self, questions: list[dict[str, Any]]) -> None:
        """Show one of these questions. If the present question is among them, it stays."""
        if questions != self._props["questions"]:
            self._props["questions"] = questions
            self.update()


class VictimQuestion:
    """Asks about one victim after another. Operators can answer; observers only see the question.

    The question takes no keys and no pointer from the page, so the operator can continue to drive.

    Args:
        watch: holds the victims.
    """

    def __init__(self, watch: VictimWatch):
        self._watch = watch

    def build(self, page: Page) -> None:
        """Add the question to a page."""
        ui.add_css(STYLE)
        card = QuestionCard(can_answer=page.can_command)
        if page.can_command:
            for text, _, _ in ANSWERS:
                page.add_key(text[0].lower(), f"Answer {text} to the question about a victim")
            page.add_key("u", "Take the answer back, for 3 s")

        def on_answer(event: GenericEventArguments) -> None:
            self._answer(page, event.args)

        card.on("answer", on_answer)
        page.always(0.2, lambda: card.show(self._questions()))

    def _answer(self, page: Page, sent: object) -> None:
        """Send the operator's answer."""
        answered = checked(sent)
        if answered is None or answered[0] not in self._watch.victims:
            return
        number, answer = answered
        page.ask(AnswerVictim(id=number, answer=answer), "the answer")

    def _questions(self) -> list[dict[str, Any]]:
        """Return the open questions, the oldest first."""
        victims = self._watch.victims.values()
        asked = sorted((one for one in victims if one.is_asked), key=lambda one: one.asked_since_s)
        return [question(one) for one in asked[:MAX_QUESTIONS]]


def question(victim: KnownVictim) -> dict[str, Any]:
    """Return the data with which a page shows the question about a victim."""
    found = victim.found
    position = found.pose.position
    silent = silence(victim.age_s, SILENT_AFTER_S)
    return {
        "id": found.id,
        "count": victim.image_count if found.image.data.size else 0,
        "text": f"{found.name}, at {position.x:.2f} m, {position.y:.2f} m",
        "left_s": round(victim.time_left_s),
        "left": f"{victim.time_left_s:.0f} s left to answer; {found.confidence:.0%} sure",
        "silent": f"no news of it for {silent}: the robot may not receive the answer" if silent else "",
    }


def checked(sent: object) -> tuple[int, int] | None:
    """Return the victim's number and the answer that a page sent, or None if they are malformed."""
    if not isinstance(sent, dict):
        return None
    number, answer = sent.get("id"), sent.get("answer")
    if type(number) is not int or type(answer) is not int or answer not in {one for _, one, _ in ANSWERS}:
        return None
    return number, answer
