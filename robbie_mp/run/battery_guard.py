"""Ends a run in order before the battery is empty."""

import math

from robbie_mp.messages import BatteryState
from robbie_mp.module.module import MessageHandling, Module, setting
from robbie_mp.module.settings import SettingError


class BatteryGuard(Module):
    """Warns when a battery is low, and ends when it is almost empty.

    With `ends_run: true` in the profile, its end stops the run in order: modules write what they must, and
    the computer can be switched off. A battery that is being charged is not low. A single low reading, as
    when motors start, is not enough.

    Its status shows the charge. If the battery falls silent, the status says so, and the run goes on.
    """

    low: float = setting(0.25, "charge below which it warns, as a ratio", minimum=0.0, maximum=1.0)
    empty: float = setting(0.1, "charge below which it ends, as a ratio", minimum=0.0, maximum=1.0)
    hold_s: float = setting(10.0, "time for which the charge must stay below a limit", minimum=0.0)
    silent_s: float = setting(30.0, "time after which a battery counts as silent", minimum=0.1)
    topic: str = setting("battery", "topic of the battery")
    period_s: float = setting(1.0, "time between looks", minimum=0.05)

    def setup(self) -> None:
        """Subscribe to the battery."""
        if self.empty > self.low:
            raise SettingError(f"must not be above low ({self.low:g})", "empty")
        self.charge = math.nan
        self.is_charging = False
        self.heard_ns = self.clock.now_ns()
        self.below_since_ns: dict[float, int | None] = {self.low: None, self.empty: None}
        self.has_warned = False
        self.subscribe(BatteryState, self.on_battery, MessageHandling.KEEP_ONLY_NEWEST, topic=self.topic)

    def on_battery(self, battery: BatteryState) -> None:
        """Remember the charge, and since when it is below the limits."""
        now_ns = self.clock.now_ns()
        self.heard_ns = now_ns
        self.charge = battery.percentage
        self.is_charging = battery.power_supply_status in (
            BatteryState.POWER_SUPPLY_STATUS_CHARGING,
            BatteryState.POWER_SUPPLY_STATUS_FULL,
        )
        for limit, since_ns in self.below_since_ns.items():
            is_below = not self.is_charging and self.charge < limit  # never, if it is not measured (NaN)
            self.below_since_ns[limit] = (now_ns if since_ns is None else since_ns) if is_below else None

    def tick(self) -> None:
        """Warn or end if the charge has been too low for long enough."""
        self.status = self.describe()
        if self.has_stayed_below(self.empty):
            self.log.error("the battery is almost empty (%.0f %%)", 100 * self.charge)
            self.stop()
        elif self.has_stayed_below(self.low):
            if not self.has_warned:
                self.log.warning(
                    "the battery is low (%.0f %%); below %.0f %% this module ends",
                    100 * self.charge,
                    100 * self.empty,
                )
            self.has_warned = True
        elif self.below_since_ns[self.low] is None:
            self.has_warned = False

    def has_stayed_below(self, limit: float) -> bool:
        """Whether the charge has been below a limit for `hold_s`, by the newest reading."""
        since_ns = self.below_since_ns[limit]
        return since_ns is not None and self.heard_ns - since_ns >= self.hold_s * 1e9

    def describe(self) -> str:
        """Return the status line."""
        silent_s = (self.clock.now_ns() - self.heard_ns) / 1e9
        if silent_s > self.silent_s:
            return f"no battery has reported for {silent_s:.0f} s"
        if math.isnan(self.charge):
            return "no charge is measured"
        return f"{self.charge:.0%}" + (", charging" if self.is_charging else "")
