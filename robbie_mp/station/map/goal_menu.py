"""The menu with the goals that wait: an operator removes them and changes their order."""

from __future__ import annotations

from nicegui import ui

from robbie_mp.station.map.goals import GoalList, Placement
from robbie_mp.station.page.menus import popup
from robbie_mp.station.page.tool_button import tool_button


class GoalMenu:
    """Shows the goals of one page's list, in the order in which the robot drives to them.

    Args:
        goals: the goals.
    """

    def __init__(self, goals: GoalList):
        self._goals = goals
        self._shown: list[Placement] | None = None
        self._button = button = tool_button("format_list_numbered", "map-goals", "Goals that wait")
        with button, popup("Goals that wait", "map-goal-list"):
            self._list = ui.column().classes("q-pa-sm gap-0")

    def tick(self) -> None:
        """List the goals, if they have changed. The button is there while goals wait."""
        if self._goals.waiting == self._shown:
            return
        self._shown = [*self._goals.waiting]
        self._button.set_visibility(bool(self._shown))
        self._list.clear()
        with self._list:
            if not self._shown:
                ui.label("no goal waits")
            for at, goal in enumerate(self._shown):
                self._build_goal(at, goal)

    def _build_goal(self, at: int, goal: Placement) -> None:
        text = f"{at + 1}: {goal.x_m:.2f} m, {goal.y_m:.2f} m"
        with ui.row().classes("items-center no-wrap full-width"):
            ui.label(text)
            ui.space()
            earlier = ui.button(icon="arrow_upward", on_click=lambda: self._goals.move_up(goal))
            earlier.props("flat dense").set_enabled(at > 0)
            earlier.props["aria-label"] = f"Drive to goal {text} earlier"
            remove = ui.button(icon="delete", on_click=lambda: self._goals.remove(goal))
            remove.props("flat dense")
            remove.props["aria-label"] = f"Remove goal {text}"
