"""The profiler: publishes the figures of `robbie top` once a second, for logs and other machines."""

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from robbie_mp.bus.observe import TOTALS, ModuleFigures, RunObserver, RunRates, RunReading, rates_between
from robbie_mp.bus.transport.words import WORD_MAX
from robbie_mp.messages import ChannelProfile, ModuleProfile, SystemProfile, Time
from robbie_mp.messages.message import fields_of
from robbie_mp.module.module import Module, setting
from robbie_mp.run.supervisor.states import state_name


class Profiler(Module):
    """Publishes a SystemProfile each `period_s`.

    In a robot's profile: `profiler: {class: "robbie_mp.attached.profiler:Profiler"}`.
    """

    period_s: float = setting(1.0, "time over which rates are measured", minimum=0.05)

    def setup(self) -> None:
        """Start observing the run."""
        self.observer = RunObserver(self.run_id)
        self.before = self.observer.read()

    def tick(self) -> None:
        """Publish the figures since the last tick."""
        now = self.observer.read()
        if now.at_ns - self.before.at_ns > self.period_s * 1e9 / 2:  # there are none at the first tick
            self.publish(system_profile(now, rates_between(self.before, now)))
            self.before = now

    def teardown(self) -> None:
        """Stop observing."""
        self.observer.close()


def system_profile(now: RunReading, rates: RunRates) -> SystemProfile:
    """Build a message from a reading and the rates since the previous reading."""
    machine = now.machine
    return SystemProfile(
        stamp=Time.from_nanoseconds(round(now.wall_time_s * 1e9)),
        interval_s=rates.interval_s,
        routed=now.core.routed,
        routed_hz=rates.routed_hz,
        messages_on_their_way=now.core.handles,
        cpu_percent=np.array(rates.cpu_percent, np.float32),
        load=np.array(machine.load, np.float32),
        memory_available_bytes=machine.memory_available_bytes,
        memory_total_bytes=machine.memory_total_bytes,
        shared_memory_used_bytes=machine.shared_memory_used_bytes,
        shared_memory_total_bytes=machine.shared_memory_total_bytes,
        modules=[_module(module, now.at_ns, rates) for module in now.modules],
        channels=list(_channels(now, rates)),
    )


_AS_THEY_ARE = (
    {field.name for field in fields_of(ModuleProfile)} & {field.name for field in fields(ModuleFigures)}
) - {"state", "refused"}
"""Figures that the message has under the same names."""


def _module(module: ModuleFigures, now_ns: int, rates: RunRates) -> ModuleProfile:
    lately = rates.modules[module.name]
    known: dict[str, Any] = {name: getattr(module, name) for name in _AS_THEY_ARE}
    known |= {total.name: module.total(total.name) for total in TOTALS}
    return ModuleProfile(
        **known,
        state=state_name(module.state),
        uptime_s=(now_ns - module.started_ns) / 1e9 if module.pid else 0.0,
        cpu_percent=lately.cpu_percent,
        in_hz=lately.in_hz,
        out_hz=lately.out_hz,
        waiting_limit=module.queue_messages,
        refused=min(module.refused, WORD_MAX),  # a sum of words that a stray pointer may have overwritten
        memory_used_bytes=module.outstanding_bytes,
        memory_limit_bytes=module.memory_bytes,
        latency_p50_s=_or_nan(lately.latency.p50_s),
        latency_p99_s=_or_nan(lately.latency.p99_s),
        handler_mean_s=_or_nan(lately.handler.mean_s),
        handler_p99_s=_or_nan(lately.handler.p99_s),
        handler_max_s=_or_nan(lately.handler.max_s),
        lateness_p99_s=_or_nan(lately.lateness.p99_s),
        busy_s=(now_ns - module.busy_since_ns) / 1e9 if module.busy_since_ns else 0.0,
    )


def _channels(now: RunReading, rates: RunRates) -> Iterator[ChannelProfile]:
    for channel in now.channels:
        lately = rates.channels[channel.type_name, channel.version, channel.topic]
        yield ChannelProfile(
            message_type=channel.type_name,
            topic=channel.topic,
            messages=channel.messages,
            bytes=channel.bytes,
            hz=lately.hz,
            bytes_per_s=lately.bytes_per_s,
            jitter_s=_or_nan(lately.jitter_s),
            age_s=(now.at_ns - channel.last_ns) / 1e9 if channel.last_ns else math.nan,
        )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
