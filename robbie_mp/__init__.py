"""Robbie-MP: a robot framework for robots that must keep going.

Everything a module's author needs is here: `from robbie_mp import Module, Message, setting`. The stock
messages (`LaserScan`, `Odometry`, ...) are in `robbie_mp.messages`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robbie_mp.attached.tool.script import AttachedRun as AttachedRun
    from robbie_mp.attached.tool.script import attach as attach
    from robbie_mp.base.errors import RobbieError as RobbieError
    from robbie_mp.base.procedure import Failed as Failed
    from robbie_mp.base.procedure import Journal as Journal
    from robbie_mp.base.procedure import Procedure as Procedure
    from robbie_mp.base.procedure import WrongJournal as WrongJournal
    from robbie_mp.base.procedure import pause as pause
    from robbie_mp.base.state_machine import IllegalTransition as IllegalTransition
    from robbie_mp.base.state_machine import StateMachine as StateMachine
    from robbie_mp.base.state_machine import TimeOut as TimeOut
    from robbie_mp.bus.transport.records import MessageHandling as MessageHandling
    from robbie_mp.messages import DEFAULT as DEFAULT
    from robbie_mp.messages import Array as Array
    from robbie_mp.messages import Duration as Duration
    from robbie_mp.messages import Feedback as Feedback
    from robbie_mp.messages import FixedLength as FixedLength
    from robbie_mp.messages import Goal as Goal
    from robbie_mp.messages import Header as Header
    from robbie_mp.messages import MaxLength as MaxLength
    from robbie_mp.messages import Message as Message
    from robbie_mp.messages import Reply as Reply
    from robbie_mp.messages import Request as Request
    from robbie_mp.messages import Result as Result
    from robbie_mp.messages import Time as Time
    from robbie_mp.messages import Upgrade as Upgrade
    from robbie_mp.messages import bool_ as bool_
    from robbie_mp.messages import byte as byte
    from robbie_mp.messages import char as char
    from robbie_mp.messages import float32 as float32
    from robbie_mp.messages import float64 as float64
    from robbie_mp.messages import int8 as int8
    from robbie_mp.messages import int16 as int16
    from robbie_mp.messages import int32 as int32
    from robbie_mp.messages import int64 as int64
    from robbie_mp.messages import replace as replace
    from robbie_mp.messages import uint8 as uint8
    from robbie_mp.messages import uint16 as uint16
    from robbie_mp.messages import uint32 as uint32
    from robbie_mp.messages import uint64 as uint64
    from robbie_mp.module.calls.client import SentGoal as SentGoal
    from robbie_mp.module.calls.errors import CallError as CallError
    from robbie_mp.module.calls.errors import CallLost as CallLost
    from robbie_mp.module.calls.errors import CallNotSent as CallNotSent
    from robbie_mp.module.calls.errors import CallRefused as CallRefused
    from robbie_mp.module.calls.errors import CallTimedOut as CallTimedOut
    from robbie_mp.module.calls.errors import GoalAborted as GoalAborted
    from robbie_mp.module.calls.errors import GoalCancelled as GoalCancelled
    from robbie_mp.module.calls.errors import GoalPreempted as GoalPreempted
    from robbie_mp.module.calls.errors import NoServer as NoServer
    from robbie_mp.module.calls.errors import ServerDied as ServerDied
    from robbie_mp.module.calls.server import ActiveGoal as ActiveGoal
    from robbie_mp.module.envelope import EncodedMessage as EncodedMessage
    from robbie_mp.module.envelope import Envelope as Envelope
    from robbie_mp.module.harness import ModuleHarness as ModuleHarness
    from robbie_mp.module.module import Module as Module
    from robbie_mp.module.secret import Secret as Secret
    from robbie_mp.module.settings import REQUIRED as REQUIRED
    from robbie_mp.module.settings import SettingError as SettingError
    from robbie_mp.module.settings import setting as setting
    from robbie_mp.module.stamp_matcher import MatchCounts as MatchCounts
    from robbie_mp.module.synchronizer import CannotSynchronize as CannotSynchronize
    from robbie_mp.module.synchronizer import Input as Input
    from robbie_mp.module.synchronizer import Synchronizer as Synchronizer
    from robbie_mp.module.timers import Timer as Timer

_HOMES = {
    "robbie_mp.base.errors": ("RobbieError",),
    "robbie_mp.messages": (
        "DEFAULT", "Array", "Duration", "Feedback", "FixedLength", "Goal", "Header", "MaxLength", "Message",
        "Reply", "Request", "Result",
        "Time", "Upgrade", "bool_", "byte", "char", "float32", "float64", "int8", "int16", "int32", "int64",
        "replace", "uint8", "uint16", "uint32", "uint64",
    ),
    "robbie_mp.module.calls.errors": (
        "CallError", "CallLost", "CallNotSent", "CallRefused", "CallTimedOut", "GoalAborted",
        "GoalCancelled", "GoalPreempted", "NoServer", "ServerDied",
    ),
    "robbie_mp.module.calls.client": ("SentGoal",),
    "robbie_mp.module.calls.server": ("ActiveGoal",),
    "robbie_mp.module.envelope": ("EncodedMessage", "Envelope"),
    "robbie_mp.module.harness": ("ModuleHarness",),
    "robbie_mp.module.module": ("Module",),
    "robbie_mp.module.secret": ("Secret",),
    "robbie_mp.module.settings": ("REQUIRED", "SettingError", "setting"),
    "robbie_mp.base.procedure": ("Failed", "Journal", "Procedure", "WrongJournal", "pause"),
    "robbie_mp.base.state_machine": ("IllegalTransition", "StateMachine", "TimeOut"),
    "robbie_mp.module.stamp_matcher": ("MatchCounts",),
    "robbie_mp.module.synchronizer": ("CannotSynchronize", "Input", "Synchronizer"),
    "robbie_mp.module.timers": ("Timer",),
    "robbie_mp.attached.tool.script": ("AttachedRun", "attach"),
    "robbie_mp.bus.transport.records": ("MessageHandling",),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = list(_HOME_OF)


def __getattr__(name: str) -> object:
    """Import a name when it is first used.

    The core and the supervisor are part of this package, too, and restart faster without numpy.
    """
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    """Return the names of the interface."""
    return sorted(__all__)
