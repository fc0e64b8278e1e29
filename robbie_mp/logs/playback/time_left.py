"""Estimates how long the rest of a playback takes."""

MEASURED_S = 2.0


class TimeLeft:
    """Measures the pace of a playback."""

    def __init__(self) -> None:
        self._since: tuple[object, float, float] | None = None

    def text(self, state: object, now_s: float, at_s: float, end_s: float) -> str:
        """Return the time that the rest takes, such as `25 s left, `; "" while it is not known.

        Args:
            state: what the pace depends on; when it changes, the pace is measured again.
            now_s: real time.
            at_s: position of the playback in the log's time.
            end_s: its end.
        """
        if self._since is None or self._since[0] != state:
            self._since = state, now_s, at_s
        _, began_s, begin_s = self._since
        passed_s, played_s = now_s - began_s, at_s - begin_s
        if passed_s < MEASURED_S or played_s <= 0:
            return ""
        left_s = max(0.0, (end_s - at_s) * passed_s / played_s)
        return f"{left_s:.0f} s left, " if left_s < 100 else f"{left_s / 60:.0f} min left, "
