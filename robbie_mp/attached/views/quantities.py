"""Numbers to read: short, and of constant width."""

BLOCKS = "▁▂▃▄▅▆▇█"


def size(count: float) -> str:
    """Format bytes as `812K` or `1.4G`."""
    if count < 1000:
        return f"{count:.0f}"
    for unit in "KMGT":
        count /= 1024
        if count < 1000 or unit == "T":
            return f"{count:.1f}{unit}" if count < 10 else f"{count:.0f}{unit}"
    raise AssertionError("unreachable")


def seconds(time_s: float | None) -> str:
    """Format a short time with its unit as `35us` or `1.2s`; '-' for None."""
    if time_s is None:
        return "-"
    if time_s < 1e-3:
        return f"{time_s * 1e6:.0f}us"
    if time_s < 1:
        return f"{time_s * 1e3:.1f}ms" if time_s < 0.1 else f"{time_s * 1e3:.0f}ms"
    return f"{time_s:.1f}s" if time_s < 100 else f"{time_s:.0f}s"


def long_time(time_s: float) -> str:
    """Format a time as hours, minutes and seconds, or as days."""
    minutes, whole_s = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    if hours >= 48:
        return f"{hours // 24}d{hours % 24:02d}h"
    return f"{hours}:{minutes:02d}:{whole_s:02d}"


def rate(per_s: float) -> str:
    """Format a rate per second."""
    return f"{per_s:.1f}" if 0 < per_s < 99.95 else f"{per_s:.0f}"


def sparkline(values: list[float], width: int) -> str:
    """Draw the last values as bars; the largest one is full."""
    shown = values[-width:]
    top = max(shown, default=0.0)
    scale = len(BLOCKS) / top if top > 0 else 0.0
    return "".join(BLOCKS[min(len(BLOCKS) - 1, int(scale * max(0.0, value)))] for value in shown).rjust(width)
