"""Numbers to read: short, and of constant width."""

BLOCKS = "▁▂▃▄▅▆▇█"
TIME_UNITS = ((1.0, "s"), (1e3, "ms"), (1e6, "us"))


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


def interval(time_s: float, deviation_s: float) -> str:
    """Format a time and its deviation in the same unit, as `50.02 ± 0.31 ms`."""
    factor, unit = next((one for one in TIME_UNITS if time_s * one[0] >= 1), TIME_UNITS[-1])
    return f"{time_s * factor:.2f} ± {deviation_s * factor:.2f} {unit}"


def decimal_size(count: float) -> str:
    """Format bytes in powers of 1000, as is usual for a bandwidth: `812 B`, `3.14 MB`."""
    for unit in ("B", "kB", "MB"):
        if count < 999.5:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.2f} GB"


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
