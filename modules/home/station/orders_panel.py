"""The household robot's orders: what it does, buttons for its tasks, and a line for orders in words."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.station.page.page import Page, ending
from robbie_mp.station.page.requests import Asked
from robbie_mp.station.page.state_item import GOOD, StateItem
from robbie_mp.station.panel import Panel
from robbie_mp.station.watch.run import REFRESH_S
from robbie_robots.modules.home.messages import CancelOrder, CarryOut, HouseholdStatus, HouseholdTask

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

MAX_ORDER_CHARACTERS = 500
MAX_ITEM_CHARACTERS = 28
IDLE = "IDLE"
OBJECT, PLACE, NAME = "object", "place", "name"
TASKS = (
    ("Bring", "Bring me the object", "bring", (OBJECT,)),
    ("Put", "Put the object on the place", "put", (OBJECT, PLACE)),
    ("Put held", "Put what it holds on the place", "put", (PLACE,)),
    ("Go", "Go to the place", "go", (PLACE,)),
    ("Name place", "Call this place by the name", "learn", (NAME,)),
    ("Follow", "Follow me", "follow", ()),
    ("Who is where", "Say who is where", "who", ()),
)
"""Each with its button's text, the same in a sentence, and what it needs of what is chosen."""


class OrdersPanel(Panel):
    """Shows the household robot's order, and lets operators give and cancel orders."""

    name = "orders"
    title = "Orders"
    icon = "room_service"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._status = station.messages.newest(HouseholdStatus)

    def state_items(self) -> Iterator[StateItem]:
        """Return what the robot does for the strip."""
        status = self._status.message
        if status is not None and status.state != IDLE:
            text = f"{status.state} {_task_text(status.tasks, status.at)}"[:MAX_ITEM_CHARACTERS]
            yield StateItem("order", self.icon, text, GOOD, status.reason)

    def build(self, page: Page) -> None:
        """Build the state, the tasks of the present order and, for operators, what gives orders."""
        with ui.row().classes("items-center gap-1 w-full"):
            state = ui.badge("").props("id=orders-state").classes("text-lg p-2")
            given: deque[Asked] = deque(maxlen=1)
            controls = OrderControls(page, given) if page.can_command else None
        reason = ui.label("").props("id=orders-reason")
        tasks = ui.label("").props("id=orders-tasks").classes("whitespace-pre-line")
        failure = ui.label("").props("id=orders-failure role=alert").classes("text-negative")

        def update() -> None:
            status = self._status.message
            state.set_text("no household robot has reported" if status is None else status.state)
            reason.set_text("" if status is None else _reason(status))
            tasks.set_text("" if status is None else _tasks(status))
            failure.set_text(ending(given[-1]) if given and given[-1].error else "")
            if controls is not None and status is not None:
                controls.update(status)

        update()
        page.every(REFRESH_S / 2, self.name, update)


class OrderControls:
    """Gives orders: by what is chosen of the robot's objects and places, and in words.

    Args:
        page: the operator's page.
        given: takes the newest order, to show how it ends.
    """

    def __init__(self, page: Page, given: deque[Asked]):
        self._page, self._given = page, given
        self._cancel = ui.button("Cancel", icon="stop", color="red-10", on_click=self._cancel_order)
        self._cancel.props("id=orders-cancel")
        words = ui.input("an order in words").classes("flex-1 min-w-0")
        words.props(f"for=orders-text dense maxlength={MAX_ORDER_CHARACTERS}")
        with ui.row().classes("w-full no-wrap gap-1"):
            self._chosen = {
                what: ui.select([], label=what, on_change=self._enable)
                .classes("flex-1 min-w-0")
                .props(f"for=orders-{what} dense")
                for what in (OBJECT, PLACE, NAME)
            }
        self._buttons: list[tuple[ui.button, str, tuple[str, ...]]] = []
        with ui.row().classes("w-full gap-1"):
            for place, (text, sentence, task, needs) in enumerate(TASKS):
                button = ui.button(text, on_click=lambda task=task, needs=needs: self._order(task, needs))
                button.props(f"no-caps id=orders-task-{place}").props["title"] = sentence
                self._buttons.append((button, task, needs))

        def say() -> None:
            if text := str(words.value or "").strip():
                self._give(CarryOut(text=text[:MAX_ORDER_CHARACTERS]))

        words.on("keyup.enter", say)
        self._status = HouseholdStatus()
        self._enable()

    def update(self, status: HouseholdStatus) -> None:
        """Offer what the robot knows."""
        self._status = status
        options = {OBJECT: status.objects, PLACE: status.places, NAME: status.names}
        for what, select in self._chosen.items():
            if select.options != options[what]:
                select.set_options(list(options[what]))
        self._cancel.set_enabled(status.state != IDLE)
        self._enable()

    def _enable(self) -> None:
        """Enable the tasks for which everything is chosen, and that the robot can do."""
        for button, task, needs in self._buttons:
            can_do = self._status.has_arm or task not in ("bring", "put")
            holds = bool(self._status.holds) or task != "put" or OBJECT in needs
            button.set_enabled(can_do and holds and all(self._chosen[what].value for what in needs))

    def _order(self, task: str, needs: Sequence[str]) -> None:
        chosen = {what: str(self._chosen[what].value or "") for what in needs}
        place = chosen.get(PLACE, chosen.get(NAME, ""))
        self._give(CarryOut(tasks=[HouseholdTask(task=task, object=chosen.get(OBJECT, ""), place=place)]))

    def _give(self, order: CarryOut) -> None:
        asked = self._page.ask(order, "the order", "the order is carried out", moves=True)
        if asked is not None:
            self._given.append(asked)

    def _cancel_order(self) -> None:
        self._page.ask(CancelOrder(reason="cancelled on the operator's page"), "the cancel")


def _reason(status: HouseholdStatus) -> str:
    """Return why the robot is in its state, what it holds, and what it does without."""
    held = f"; it holds the {status.holds}" if status.holds else ""
    return f"{status.reason}{held}" + ("" if status.has_arm else "; it has no arm that it can use")


def _tasks(status: HouseholdStatus) -> str:
    """Return the tasks of the present order, a line each."""
    signs = ["✓"] * status.at + ["▶"] + ["·"] * len(status.tasks)
    texts = [_task_text(status.tasks, place) for place in range(len(status.tasks))]
    return "\n".join(f"{sign} {text}" for sign, text in zip(signs, texts, strict=False))


def _task_text(tasks: Sequence[HouseholdTask], place: int) -> str:
    """Return a task in words."""
    if place >= len(tasks):
        return ""
    one = tasks[place]
    return " ".join(word for word in (one.task, one.object, "→" if one.place else "", one.place) if word)
