"""Says from a robot's true motion whether it stood soon enough after a failure."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STANDS_M_PER_S, STANDS_RAD_PER_S = 0.005, 0.01
LASTS_S = 0.2
"""A stop that is shorter does not count as standing."""
GAP_S = 0.35
"""Nothing is known of a robot whose motion was not seen for longer than this."""
SLACK_S = 0.05
"""When a process is back is seen this much later than it is, at most."""


@dataclass(frozen=True)
class TrueMotion:
    """What a robot did after a failure; times in s since then.

    Attributes:
        stands_s: when it first stood; infinite: it did not; NaN: nobody saw.
        resumed_s: when it moved again after that; infinite: it did not.
        fresh_s: when what had failed gave something new again; infinite: it did not.
        driven_m: how far it drove until it stood, or until the end.
        blind_m: how far it drove while what had failed gave nothing new.
        speed_m_per_s: its speed at the failure.
    """

    stands_s: float
    resumed_s: float
    fresh_s: float
    driven_m: float
    blind_m: float
    speed_m_per_s: float

    def keeps(self, limit_s: float) -> bool:
        """Whether it stood in time, or had fresh data again by then, and moved again only with fresh data."""
        return min(self.stands_s, self.fresh_s) <= limit_s and self.resumed_s >= self.fresh_s - SLACK_S


def judge(
    rows: NDArray[np.float64], failed_s: float, fresh_s: float, until_s: float, limit_s: float
) -> TrueMotion:
    """Judge a robot's motion.

    Args:
        rows: `(N, 5)`: time (s), speed (m/s), turn rate (rad/s), x and y (m); times increase.
        failed_s: time of the failure.
        fresh_s: when what had failed gave something new again; infinite: never.
        until_s: the end of what is judged.
        limit_s: within which it must stand, after the failure: until then, it may stand and move again.
    """
    before = rows[rows[:, 0] <= failed_s][-1:]
    seen = np.concatenate([before, rows[(rows[:, 0] > failed_s) & (rows[:, 0] <= until_s)]])
    speed = float(abs(before[0, 1])) if len(before) else math.nan
    if not len(before) or np.diff([*seen[:, 0], until_s]).max() > GAP_S:
        return TrueMotion(math.nan, math.nan, fresh_s - failed_s, math.nan, math.nan, speed)
    at_s = seen[:, 0] - failed_s
    moves = (np.abs(seen[:, 1]) > STANDS_M_PER_S) | (np.abs(seen[:, 2]) > STANDS_RAD_PER_S)
    stands_s, resumed_s = _first_stand(at_s, moves, until_s - failed_s, limit_s)
    return TrueMotion(
        stands_s=stands_s,
        resumed_s=resumed_s,
        fresh_s=fresh_s - failed_s,
        driven_m=_way_m(seen, at_s, stands_s),
        blind_m=_way_m(seen, at_s, fresh_s - failed_s),
        speed_m_per_s=speed,
    )


def _first_stand(
    at_s: NDArray[np.float64], moves: NDArray[np.bool_], end_s: float, limit_s: float
) -> tuple[float, float]:
    """Return when a robot first stood for `LASTS_S`, and beyond the limit, and when it moved after that."""
    began = math.inf
    for time_s, is_moving in zip([*at_s, end_s], [*moves, False], strict=True):
        if time_s - began >= LASTS_S:
            later = float(min(at_s[(at_s >= time_s) & moves], default=math.inf))
            if later > limit_s:
                return max(0.0, began), later
        began = math.inf if is_moving else min(began, float(time_s))
    return math.inf, math.inf


def _way_m(seen: NDArray[np.float64], at_s: NDArray[np.float64], until_s: float) -> float:
    """Return the length of the way until a time."""
    points = seen[at_s <= until_s][:, 3:]
    return float(np.hypot(*np.diff(points, axis=0).T).sum()) if len(points) > 1 else 0.0
