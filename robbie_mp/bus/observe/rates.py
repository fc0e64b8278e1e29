"""Changes between two readings of a run: rates, processor use, and durations."""

import math
from dataclasses import dataclass

from robbie_mp.bus.observe.figures import ChannelFigures, ModuleFigures, RunReading
from robbie_mp.bus.transport.histogram import Distribution
from robbie_mp.bus.transport.words import WORD_MAX


@dataclass(frozen=True)
class ModuleRates:
    """The rates of one module."""

    cpu_percent: float
    """Share of one processor."""
    in_hz: float
    """Messages handled."""
    out_hz: float
    """Messages handed to the core."""
    replaced_hz: float
    overflowed_hz: float
    """Messages dropped because the queue was full."""
    tick_hz: float
    wakeups_hz: float
    latency: Distribution
    handler: Distribution
    lateness: Distribution
    tick: Distribution


@dataclass(frozen=True)
class ChannelRates:
    """The rates of one channel."""

    hz: float = 0.0
    bytes_per_s: float = 0.0
    jitter_s: float | None = None
    """Standard deviation of the time between two messages; None if there are fewer than two such times."""


@dataclass(frozen=True)
class RunRates:
    """The rates of the whole run."""

    interval_s: float
    routed_hz: float
    wakeups_hz: float
    """Wake-ups of the core."""
    cpu_percent: tuple[float, ...]
    """Use of each processor of the machine, by all processes."""
    modules: dict[str, ModuleRates]
    channels: dict[tuple[str, int, str], ChannelRates]
    """By type, version and topic."""


def rates_between(before: RunReading, now: RunReading, *, long_before: RunReading | None = None) -> RunRates:
    """Compare two readings of a run.

    Args:
        before: the earlier one.
        now: the later one.
        long_before: an even earlier one, where the durations start: quantiles need many samples.
    """
    interval_s = max(1e-9, (now.at_ns - before.at_ns) / 1e9)
    modules = {module.name: module for module in before.modules}
    long_ago = {module.name: module for module in (long_before or before).modules}
    channels = {_key(channel): channel for channel in before.channels}
    processors = zip(before.machine.cpu_busy_s, now.machine.cpu_busy_s, strict=False)
    return RunRates(
        interval_s=interval_s,
        routed_hz=(now.core.routed - before.core.routed) / interval_s,
        wakeups_hz=max(0, now.core.wakeups - before.core.wakeups) / interval_s,
        cpu_percent=tuple(
            min(100.0, max(0.0, 100 * (later - earlier) / interval_s)) for earlier, later in processors
        ),
        modules={
            module.name: _module_rates(
                modules.get(module.name, module), long_ago.get(module.name, module), module, interval_s
            )
            for module in now.modules
        },
        channels={
            _key(channel): _channel_rates(channels.get(_key(channel)), channel, interval_s)
            for channel in now.channels
        },
    )


def _key(channel: ChannelFigures) -> tuple[str, int, str]:
    return channel.type_name, channel.version, channel.topic


def _module_rates(
    before: ModuleFigures, long_before: ModuleFigures, now: ModuleFigures, interval_s: float
) -> ModuleRates:
    is_same = now.incarnation == before.incarnation

    def rate(column: str) -> float:
        # For a moment, the counters of a dying module are neither in its own memory nor in its past totals.
        passed: float = getattr(now, column) - getattr(before, column)
        return max(0.0, passed) / interval_s

    return ModuleRates(
        cpu_percent=100 * rate("cpu_s"),
        in_hz=rate("handled"),
        out_hz=rate("published"),
        replaced_hz=max(0, now.total("replaced") - before.total("replaced")) / interval_s,
        overflowed_hz=max(0, now.total("overflowed") - before.total("overflowed")) / interval_s,
        tick_hz=rate("ticks") if is_same else now.ticks / interval_s,
        wakeups_hz=rate("wakeups") if is_same else now.wakeups / interval_s,
        latency=_times("latency", long_before, now),
        handler=_times("handler", long_before, now),
        lateness=_times("lateness", long_before, now),
        tick=_times("tick", long_before, now),
    )


def _times(kind: str, before: ModuleFigures, now: ModuleFigures) -> Distribution:
    if now.work is None:
        return Distribution()
    is_same = before.work is not None and before.incarnation == now.incarnation
    distribution: Distribution = getattr(now.work, kind).distribution(
        getattr(before.work, kind) if is_same else None
    )
    return distribution


def _channel_rates(before: ChannelFigures | None, now: ChannelFigures, interval_s: float) -> ChannelRates:
    if before is None:
        return ChannelRates(now.messages / interval_s, now.bytes / interval_s)
    return ChannelRates(
        (now.messages - before.messages) / interval_s,
        (now.bytes - before.bytes) / interval_s,
        _jitter_s(before, now),
    )


def _jitter_s(before: ChannelFigures, now: ChannelFigures) -> float | None:
    count = now.messages - before.messages
    if count < 2 or not before.last_ns:
        return None
    squares_us2 = now.intervals_squared - before.intervals_squared
    return intervals_deviation_s(before.last_ns, now.last_ns, count, squares_us2)


def intervals_deviation_s(first_ns: int, last_ns: int, count: int, squares_us2: int) -> float:
    """Return the standard deviation of the times between messages.

    The core counts stamps in whole µs. Mean and squares are of these stamps, and are compared in integers:
    they are large, and their difference is small. So the error is below 1 µs, whatever the period.

    Args:
        first_ns: stamp of the message before the first interval.
        last_ns: stamp of the last message.
        count: number of intervals; at least 1.
        squares_us2: sum of their squares, modulo 2^64.
    """
    total_us = last_ns // 1000 - first_ns // 1000
    return math.sqrt(max(0, count * (squares_us2 & WORD_MAX) - total_us * total_us)) / count / 1e6
