"""The driver of one page: the robot moves only while the operator holds a control."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import ui
from nicegui.element import Element

from robbie_mp.connect.link.operators import MANUAL_TOPIC
from robbie_mp.messages import DriveCommand
from robbie_mp.station.context import header_of_now
from robbie_mp.station.driving.dead_man import LIMIT_S, PING_PERIOD_S
from robbie_mp.station.driving.held_control import VALID_FOR, HeldControl
from robbie_mp.station.watch.births import time_before

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.module import Publish
    from robbie_mp.station.page.page import Page

MIN_LINEAR_M_PER_S, MIN_ANGULAR_RAD_PER_S = 0.05, 0.1
AHEAD_S = 0.1
"""A picture may seem to come from the future by this: the clock of the robot is estimated."""
FULL_SPEED_AGE_S, MIN_SHARE = 0.5, 0.1
"""Up to this age of the picture there is the whole top speed; of any older one, at least this share."""
FULL_SPEED_DELAY_S = 0.12
"""The same of the round trip; with one of `LIMIT_S`, the page does not drive."""
STEP = 1.25
"""Factor by which one press on a key changes the maximum speeds."""


class DriverKeys(Element, component="driver.js"):
    """Listens to keys, the gamepad and the pads of the page, and answers pings."""


class DriverInput(NamedTuple):
    """What the page of a driver has sent."""

    held: bool
    begins: bool
    linear: float
    """From -1 to 1, as `angular`; 0 when the operator has let go."""
    angular: float
    sent_s: float
    unguarded: bool = False
    picture_age_s: float = 0.0
    """Of the picture that the operator sees; 0 if none is in sight."""


class Driver:
    """Drives for an operator's page, whatever its layout.

    Args:
        station: has the speed limits, and knows who drives.
        page: publishes the commands.
        publish: publishes the command to stop when the page is gone.

    Attributes:
        linear_m_per_s: speed while a control is held to its end.
        angular_rad_per_s: turn rate while a control is held to its end.
        without_guard: whether this drive is not guarded against collisions; ends when the operator lets go.
        slowed: the share of these speeds that the picture's age and the network's delay allow.
    """

    def __init__(self, station: StationContext, page: Page, publish: Publish):
        self._settings = station.settings
        self._clock = station.clock
        self._motion = station.robot.motion
        self._operators = station.operators
        self._page = page
        self._publish = publish
        self._control = HeldControl(station.operators, page, "driving")
        self.linear_m_per_s = self._settings.max_linear_m_per_s / 2
        self.angular_rad_per_s = self._settings.max_angular_rad_per_s / 2
        self._last = DriveCommand()
        self._last_s = -math.inf
        self.without_guard = False
        self.slowed = 1.0
        self._keys = DriverKeys().props("id=driver")
        self._keys.on("drive", self._on_drive).on("pong", self._on_pong)
        ui.timer(PING_PERIOD_S, self._look_at_network)  # also while the browser does not keep up
        ui.context.client.on_disconnect(self._stop_without_page)

    @property
    def stale(self) -> int:
        """Number of commands that came too late."""
        return self._control.stale

    @property
    def refused(self) -> int:
        """Number of commands refused here because an operator elsewhere drives."""
        return self._control.refused

    @property
    def is_other_driving(self) -> bool:
        """Whether another page, or an operator elsewhere, drives."""
        return self._control.is_other_driving

    @property
    def delay(self) -> str:
        """Why the network does not allow to drive; '' if it does."""
        switch = self._page.dead_man
        delay_s = switch.delay_s(time.monotonic())
        return f"delay {delay_s:.1f} s: too long to drive" if switch.is_too_slow else ""

    def take_over(self) -> None:
        """Drive instead of the page or the operator elsewhere that drives now."""
        if self._page.may("taking over"):
            self._operators.seat.take(self._page.key, over=True)
            self._operators.command.take(over=True)

    def change_limits(self, up: bool) -> None:
        """Drive faster or slower from now on."""
        factor = STEP if up else 1 / STEP
        linear, angular = self.linear_m_per_s * factor, self.angular_rad_per_s * factor
        most = self._settings
        self.linear_m_per_s = min(most.max_linear_m_per_s, max(MIN_LINEAR_M_PER_S, linear))
        self.angular_rad_per_s = min(most.max_angular_rad_per_s, max(MIN_ANGULAR_RAD_PER_S, angular))

    def _on_drive(self, event: GenericEventArguments) -> None:
        wish = checked(event.args)
        if wish is None:
            return
        self.without_guard = self.without_guard and wish.held
        trip_s = self._page.dead_man.trip_s(time.monotonic())
        self.slowed = min(share_of_speed(wish.picture_age_s), share_by_delay(trip_s))
        header = header_of_now(self._clock, "base_link")  # first: the age counts from then
        age_s = self._control.age_s(held=wish.held, begins=wish.begins, sent_s=wish.sent_s)
        if age_s is None:
            return
        command_message = DriveCommand(
            header=header,
            linear_m_per_s=wish.linear * self.linear_m_per_s * self.slowed,
            angular_rad_per_s=wish.angular * self.angular_rad_per_s * self.slowed,
            valid_for=VALID_FOR,
            based_on=time_before(header.stamp, age_s),
            unguarded=wish.unguarded or self.without_guard,
        )
        self._last, self._last_s = command_message, time.monotonic()
        self._page.publish(command_message, "the command", MANUAL_TOPIC)
        self._motion.command(command_message)

    def _on_pong(self, event: GenericEventArguments) -> None:
        try:
            number, page_s = int(event.args["number"]), float(event.args["page_s"])
        except (KeyError, TypeError, ValueError, OverflowError):
            return
        now_s = time.monotonic()
        is_asked = self._page.dead_man.pong(number, page_s, now_s)
        if is_asked and (trip_s := self._page.dead_man.trip_s(now_s)) is not None:
            self._page.network.ping_came(trip_s, now_s)

    def _look_at_network(self) -> None:
        """Ping the page, and give up control while its network is too slow."""
        switch, now_s = self._page.dead_man, time.monotonic()
        if self._page.link.is_free:
            self._keys.run_method("answer", switch.ping(now_s))
        switch.look(now_s)
        if switch.is_too_slow and self._operators.seat.holder == self._page.key:
            self._operators.seat.leave(self._page.key)
            self._operators.command.give_up()

    def _stop_without_page(self) -> None:
        """Stop the robot at once if the page's connection ends while it drives.

        The last command would expire a little later. A page that connects again drives on.
        """
        self.without_guard = False
        moves = self._last.linear_m_per_s or self._last.angular_rad_per_s
        is_valid = time.monotonic() - self._last_s < VALID_FOR.nanoseconds / 1e9
        if moves and is_valid and self._operators.seat.holder == self._page.key:
            stop = DriveCommand(header=header_of_now(self._clock, "base_link"), valid_for=VALID_FOR)
            # Not by `Page.publish`: the session may have ended, and everyone may stop the robot.
            self._publish(stop, topic=MANUAL_TOPIC)
            self._motion.command(stop)


def checked(sent: Any) -> DriverInput | None:
    """Return what the page sent, with speeds from -1 to 1; None if it is malformed."""
    try:
        linear, angular, sent_s = (float(sent[name]) for name in ("linear", "angular", "sent_s"))
        picture_age_s = _age(sent.get("picture_age_s"))
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    if not all(map(math.isfinite, (linear, angular, sent_s))):
        return None
    held = bool(sent.get("held"))
    linear, angular = (max(-1.0, min(1.0, speed)) if held else 0.0 for speed in (linear, angular))
    begins, unguarded = bool(sent.get("begins")), bool(sent.get("unguarded"))
    return DriverInput(held, begins, linear, angular, sent_s, unguarded, picture_age_s)


def _age(seen_s: Any) -> float:
    """Return the age of a picture; inf if the page's clock cannot be right. Without one in sight, it is 0.

    Raises:
        TypeError, ValueError, OverflowError: it is no number.
    """
    if seen_s is None:
        return 0.0
    age_s = float(seen_s)
    if math.isnan(age_s):
        raise ValueError("the age of a picture is NaN")
    return max(0.0, age_s) if age_s > -AHEAD_S else math.inf


def share_of_speed(picture_age_s: float) -> float:
    """Return the share of the top speed that the age of the operator's picture allows.

    So the way that the robot goes until the operator sees it does not grow with that age.
    """
    return max(MIN_SHARE, min(1.0, FULL_SPEED_AGE_S / max(picture_age_s, FULL_SPEED_AGE_S)))


def share_by_delay(trip_s: float | None) -> float:
    """Return the share of the top speed that the round trip to the page allows; None: it is not known.

    It falls evenly to the least one where the page does not drive any more, so the operator sees that coming.
    """
    beyond = ((LIMIT_S if trip_s is None else trip_s) - FULL_SPEED_DELAY_S) / (LIMIT_S - FULL_SPEED_DELAY_S)
    return 1.0 - (1.0 - MIN_SHARE) * max(0.0, min(1.0, beyond))
