"""Observes a run from outside: maps the board, the core tables and the modules' own words read-only.

Observing costs the robot nothing, and works while the core is down.
"""

from robbie_mp.bus.observe.figures import TOTALS as TOTALS
from robbie_mp.bus.observe.figures import ChannelFigures as ChannelFigures
from robbie_mp.bus.observe.figures import CoreFigures as CoreFigures
from robbie_mp.bus.observe.figures import ModuleFigures as ModuleFigures
from robbie_mp.bus.observe.figures import RunReading as RunReading
from robbie_mp.bus.observe.figures import SubscriptionFigures as SubscriptionFigures
from robbie_mp.bus.observe.figures import Total as Total
from robbie_mp.bus.observe.figures import WorkHistograms as WorkHistograms
from robbie_mp.bus.observe.rates import ChannelRates as ChannelRates
from robbie_mp.bus.observe.rates import ModuleRates as ModuleRates
from robbie_mp.bus.observe.rates import RunRates as RunRates
from robbie_mp.bus.observe.rates import rates_between as rates_between
from robbie_mp.bus.observe.run_observer import RunObserver as RunObserver
