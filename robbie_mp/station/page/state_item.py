"""One thing in the strip at the top of the page."""

from dataclasses import dataclass

GOOD, WARNING, ALERT, UNKNOWN = "", "is-warning", "is-alert", "is-unknown"


@dataclass(frozen=True)
class StateItem:
    """One thing in the strip at the top of the page."""

    name: str
    """A panel's item replaces one of the strip's own that has the same name."""
    icon: str
    """Name of a Material Icon of NiceGUI."""
    text: str
    look: str = GOOD
    """GOOD, WARNING, ALERT or UNKNOWN; ALERT only for what needs a hand."""
    detail: str = ""
    """Shown when the pointer rests on it."""
    alarm: str = ""
    """Sentence of the alarm that the item is while its look is WARNING or ALERT; '': it is none."""


def clock_text(time_s: float) -> str:
    """Return a time as minutes and seconds, or hours and minutes."""
    minutes, seconds = divmod(int(time_s), 60)
    return f"{minutes}:{seconds:02d}" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d}"
