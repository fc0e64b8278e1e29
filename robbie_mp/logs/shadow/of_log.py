"""The shadow of a module in a log: as fast as it goes, with the time of the log."""

from collections.abc import Callable

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.recording.format import RUN_METADATA, RunMetadata
from robbie_mp.logs.recording.reader import Log
from robbie_mp.logs.shadow.beside import ShadowProcess
from robbie_mp.logs.shadow.comparison import Comparison, ShadowReport, distribution_of
from robbie_mp.logs.shadow.frames import Begin, Given
from robbie_mp.logs.shadow.pairing import Side
from robbie_mp.run.profile.model import ModuleSpec

PUMP_S = 0.05
HANGS_AFTER = 400
"""A shadow that handles nothing for this many times `PUMP_S` counts as hung."""
EXPIRE_EVERY = 256


class NotInLog(RobbieError, LookupError):
    """A log cannot tell what a module was or published.

    Example scenarios:
      - the module's name is misspelt
      - another program has recorded the log
    """


def recorded_module(log: Log, name: str) -> ModuleSpec:
    """Return what the profile of a log's run says about a module.

    Raises:
        NotInLog: the log does not hold it.
    """
    for record in log.metadata(RUN_METADATA):
        profile = read_text(RunMetadata.from_metadata(record).profile_yaml, log.path).plain()
        modules = profile.get("modules", {}) if isinstance(profile, dict) else {}
        if name in modules:
            entry = modules[name]
            return ModuleSpec(
                name,
                str(entry["class"]),
                settings=entry.get("settings") or {},
                topics=entry.get("topics") or {},
                namespace=entry.get("namespace") or "",
            )
        near = did_you_mean(name, modules) or f"; there are {', '.join(modules)}"
        raise NotInLog(f"the run of {log.path} had no module {name!r}{near}")
    raise NotInLog(f"{log.path} does not say which modules there were: no run of Robbie-MP has recorded it")


def shadow_of_log(log: Log, begin: Begin, is_over: Callable[[], bool]) -> ShadowReport:
    """Feed a shadow with the messages of a log, and compare what it publishes with what the module did.

    Args:
        log: the log.
        begin: what the shadow is.
        is_over: asked often; true ends it before the end of the log.

    Raises:
        ShadowFailed: it cannot be set up.
    """
    schemas = {channel.key[:2]: channel.schema for channel in log.channels}
    comparison = Comparison(log.start_ns, lambda *key: schemas.get(key))
    with ShadowProcess(begin, 1, is_over) as shadow:
        shadow.wait_until_ready()
        shadow.start(log.start_ns, None)
        last_ns = log.start_ns
        for number, message in enumerate(log.messages()):
            channel = message.channel
            name = ChannelName(channel.type_name, channel.version, channel.topic)
            if channel.sender == begin.name:
                comparison.add(Side.MODULE, name, message.time_ns, message.data)
            if shadow.wants(*name) is not False:
                last_ns = max(last_ns, message.time_ns)
                shadow.feed.add(Given(last_ns, *name, channel.sender, message.data))
            if number % EXPIRE_EVERY == 0:
                comparison.expire(min(shadow.done_ns, last_ns))
            if is_over() or not _pump(shadow, comparison, lambda: not shadow.feed.is_full):
                break
        _pump(shadow, comparison, lambda: not shadow.unhandled)
        return ShadowReport(
            channels=comparison.end(min(shadow.done_ns, last_ns)),
            handled=shadow.handled,
            lost=shadow.feed.lost,
            replaced=0,
            unhandled=shadow.unhandled,
            calls=shadow.calls,
            module_times=None,
            shadow_times=distribution_of(list(shadow.times_ns)),
            end=shadow.end,
            from_checkpoint=False,
        )


def _pump(shadow: ShadowProcess, comparison: Comparison, is_done: Callable[[], bool]) -> bool:
    """Pump until a condition holds; False if the shadow has ended or hangs."""
    wait_s, idle = 0.0, 0
    while not shadow.end and idle < HANGS_AFTER:
        handled = shadow.handled
        for said in shadow.pump(wait_s):
            name = ChannelName(said.type_name, said.version, said.topic)
            comparison.add(Side.SHADOW, name, said.time_ns, said.data)
        if is_done():
            return not shadow.end
        wait_s = PUMP_S
        idle = 0 if shadow.handled > handled else idle + 1
    return False
