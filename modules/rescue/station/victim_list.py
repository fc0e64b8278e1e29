"""The list of victims: each with its picture, and for operators with a button that sends the robot there."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from nicegui import ui

from robbie_mp.messages import Header, NavigateTo, Point, Pose, PoseStamped, Quaternion
from robbie_mp.station.panel import columns
from robbie_robots.modules.rescue.station.victim_watch import STATES, KnownVictim, VictimWatch

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.station.page.page import Page

STANDS_BEFORE_M = 0.6
"""Distance from the wall with the victim to the middle of a robot that is sent there."""
PICTURE = """<q-td :props="props"><img v-if="props.row.picture" :src="props.row.picture"
  :alt="'what the camera has seen of ' + props.row.name" class="victim-picture"></q-td>"""
BUTTONS = """<q-td :props="props"><div class="victim-buttons">
  <q-btn v-if="props.row.can_go" unelevated color="primary" label="Go" :aria-label="'Go to ' + props.row.name"
    @click="() => $parent.$emit('go', props.row.number)" />
  <q-btn outline label="Show" :aria-label="'Show ' + props.row.name + ' on the map'"
    @click="() => $parent.$emit('show', props.row.number)" />
</div></q-td>"""
SHOW = "window.show_on_map({})"


class VictimList:
    """Lists the victims on one page.

    Args:
        page: the page.
        watch: holds the victims.
    """

    def __init__(self, page: Page, watch: VictimWatch):
        self._page, self._watch = page, watch
        request = ui.context.client.request
        self._prefix = request.scope.get("root_path", "") if request else ""
        names = columns("picture", "number", "name", "state", "x in m", "y in m", "sure", "images", "act")
        names[0]["label"] = names[-1]["label"] = ""
        self._table = ui.table(columns=names, rows=[], row_key="number", title="Victims")
        self._table.props("dense flat id=mission-victims").classes("w-full")
        self._table.add_slot("body-cell-picture", PICTURE)
        self._table.add_slot("body-cell-act", BUTTONS)
        self._table.on("go", self._go)
        self._table.on("show", self._show)

    def update(self) -> None:
        """Show the victims as they are now."""
        self._table.rows = [self._row(one) for _, one in sorted(self._watch.victims.items())]

    def _row(self, victim: KnownVictim) -> dict[str, Any]:
        found, position = victim.found, victim.found.pose.position
        address = f"{self._prefix}/pictures/victim/{found.id}?count={victim.image_count}"
        return {
            "picture": address if found.image.data.size else "",
            "number": found.id,
            "name": found.name,
            "state": STATES.get(found.state, str(found.state)),
            "x in m": f"{position.x:.2f}",
            "y in m": f"{position.y:.2f}",
            "sure": f"{found.confidence:.0%}",
            "images": found.views,
            "can_go": self._page.can_command,
        }

    def _pressed(self, event: GenericEventArguments) -> KnownVictim | None:
        return self._watch.victims.get(event.args) if type(event.args) is int else None

    def _go(self, event: GenericEventArguments) -> None:
        if (victim := self._pressed(event)) is not None:
            name = victim.found.name
            goal = NavigateTo(pose=place_before(victim))
            self._page.ask(goal, f"the way to {name}", f"the robot is at {name}", moves=True)

    def _show(self, event: GenericEventArguments) -> None:
        if (victim := self._pressed(event)) is not None:
            position = victim.found.pose.position
            ui.run_javascript(SHOW.format(json.dumps({"x": position.x, "y": position.y})))


def place_before(victim: KnownVictim) -> PoseStamped:
    """Return where a robot stands to look at a victim: before its wall, and towards it."""
    pose = victim.found.pose
    yaw_rad = pose.orientation.yaw
    x_m = pose.position.x + STANDS_BEFORE_M * math.cos(yaw_rad)
    y_m = pose.position.y + STANDS_BEFORE_M * math.sin(yaw_rad)
    place = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad + math.pi))
    return PoseStamped(header=Header(frame_id=victim.found.header.frame_id), pose=place)
