"""Observes a run from outside: maps the board, the core tables and the modules' own words read-only.

Observing costs the robot nothing, and works while the core is down.
"""

from robbie_mp.bus.observe.figures import (
    TOTALS,
    ChannelFigures,
    CoreFigures,
    ModuleFigures,
    RunReading,
    SubscriptionFigures,
    Total,
    WorkHistograms,
)
from robbie_mp.bus.observe.rates import ChannelRates, ModuleRates, RunRates, rates_between
from robbie_mp.bus.observe.run_observer import RunObserver

__all__ = [
    "TOTALS",
    "ChannelFigures",
    "ChannelRates",
    "CoreFigures",
    "ModuleFigures",
    "ModuleRates",
    "RunObserver",
    "RunRates",
    "RunReading",
    "SubscriptionFigures",
    "Total",
    "WorkHistograms",
    "rates_between",
]
