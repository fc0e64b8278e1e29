"""How far wheel odometry may be off, learnt from how well it predicts good matches.

At first, odometry is assumed to be that of an uncalibrated robot. After each stretch of the way, a running
average of its squared error is updated, separately for each axis: along, across, and heading. A match counts
for an axis only if it knows more about it than odometry does, and in proportion: otherwise a robot in a bare
corridor would consider its odometry perfect. In outline, this is the adaptive estimation of Mehra, "On the
identification of variances and adaptive Kalman filtering" (1970), with clipped errors (Huber).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import compose, relative, wrap_angle

STRETCH_M, STRETCH_RAD = 1.5, 1.0  # errors of shorter ways say little of longer ones
PRIOR, MOST = 6.0, 60.0  # weight of the first guess, and greatest weight of the past, in stretches
LEAST_KNOWN = 0.5  # share of what is known of an axis that must come from the match
CUT = 9.0  # squared errors are clipped here, in variances
WHOLE_SLIP, LEAST_SLIP = (
    0.25,
    0.2,
)  # m or rad of a step with the full slip; least share of it
LEAST, GREATEST = 0.05**2, 1.5**2  # of the variance, as a share of the first guess


class OdometryDeviation:
    """The standard deviation of odometry over a step."""

    def __init__(self) -> None:
        self._share = np.ones(3)  # of the first guess's variance
        self._count = np.full(3, PRIOR)
        self._begin()

    def _begin(self) -> None:
        self._odometry, self._matched = np.zeros(3), np.zeros(3)
        self._turned, self._known = 0.0, np.ones(3)

    @property
    def share(self) -> NDArray[np.float64]:
        """The learnt standard deviation along, across, and in heading, as a share of the first guess."""
        return np.sqrt(self._share)

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Return what was learnt."""
        stretch = np.array([self._odometry, self._matched, self._known])
        return {
            "share": self._share.copy(),
            "count": self._count.copy(),
            "stretch": stretch,
            "turned": np.array(self._turned),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self._share, self._count = np.array(state["share"]), np.array(state["count"])
        self._odometry, self._matched, self._known = np.array(state["stretch"])
        self._turned = float(state["turned"])

    def over(self, step: ArrayLike) -> NDArray[np.float64]:
        """Return the standard deviation over a step (x m, y m, heading rad)."""
        return self.share * first_guess(step)

    def learn(self, step: ArrayLike, matched: ArrayLike, known: NDArray[np.float64]) -> None:
        """Compare a step by odometry with the same by a match.

        Args:
            step: Odometry's motion.
            matched: The motion between two matches, fused with odometry.
            known: For each axis the share of what is known of the second one that comes from the match alone.
        """
        self._odometry = compose(self._odometry, step)
        self._matched = compose(self._matched, matched)
        self._known = np.minimum(self._known, known)
        self._turned += abs(float(np.asarray(step)[2]))
        if np.hypot(*self._odometry[:2]) < STRETCH_M and self._turned < STRETCH_RAD:
            return
        off = relative(self._odometry, self._matched)
        off[2] = wrap_angle(off[2])
        expected = first_guess([*self._odometry[:2], self._turned])
        error = np.minimum((off / np.maximum(self._known, LEAST_KNOWN) / expected) ** 2, CUT * self._share)
        weight = np.where(self._known >= LEAST_KNOWN, self._known, 0.0)
        total = self._count + weight
        self._share = np.clip((self._count * self._share + weight * error) / total, LEAST, GREATEST)
        self._count = np.minimum(total, MOST)
        self._begin()

    def interrupt(self) -> None:
        """Begin a new stretch, because the robot was found elsewhere."""
        self._begin()


def first_guess(step: ArrayLike) -> NDArray[np.float64]:
    """Return the standard deviation of an unknown robot's odometry over a step (x m, y m, heading rad).

    It is roughly a tenth of the motion plus some slip, so that it also holds for an uncalibrated robot.
    """
    dx, dy, turn = np.abs(np.asarray(step, float))
    distance = float(np.hypot(dx, dy))
    slip = np.clip((distance + turn) / WHOLE_SLIP, LEAST_SLIP, 1.0)
    across = 0.03 * slip + 0.1 * distance + 0.05 * turn
    return np.array([across, across, 0.02 * slip + 0.05 * distance + 0.1 * turn])
