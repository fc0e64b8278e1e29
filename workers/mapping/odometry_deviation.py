"""How far wheel odometry may be off, learnt from how well it predicts good matches.

Odometry errs in two ways. Systematic errors of scale and heading, and of the angle at which the laser is
mounted, stay the same for long: a Kalman filter estimates them from stretches of the way, and the estimate
corrects odometry, also where a bare corridor shows nothing. The rest is random. At first, odometry is assumed
to be that of an uncalibrated robot; after each stretch, its error makes some variances more likely than
others, separately along, across, and in heading. The likelihood contains the noise of matches and what they
do not know, so a bare corridor teaches nothing. In outline: Mehra, "On the identification of variances and
adaptive Kalman filtering" (1970), and Roy and Thrun, "Online self-calibration for mobile robots" (ICRA 1999),
with clipped errors (Huber).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import compose, relative, wrap_angle

STRETCH_M, STRETCH_RAD = 1.5, 1.0  # errors of shorter ways say little of longer ones
MEMORY = 60.0  # stretches after which what was learnt counts for a third
CUT = 3.0  # standard deviations at which errors are clipped
UNUSUAL = 3.0  # standard deviations by which a turn must differ from the usual curve of the way
WHOLE_SLIP, LEAST_SLIP = 0.25, 0.2  # m or rad of a step with the full slip; least share of it
SHARES = np.geomspace(0.05, np.sqrt(2.0), 100)  # possible standard deviations, as a share of the first guess
SYSTEMATIC = np.diag([0.1, 0.01, 0.05, 0.1]) ** 2  # covariance of `systematic`, of an unknown robot
LEAST_SEEN = 1e-3


class OdometryDeviation:
    """Odometry's systematic errors, and its standard deviation over a step without them.

    Attributes:
        systematic: Share by which a way is longer than odometry says; angle (rad) by which it is farther to
            the left, because the laser is mounted that much farther to the right than its pose says; and a
            robot's turn beyond what odometry says, rad for each m and for each rad.
    """

    def __init__(self) -> None:
        self.systematic = np.zeros(4)
        self._covariance = SYSTEMATIC.copy()
        self._likelihood = np.zeros((3, len(SHARES)))  # logarithms
        self._usual = np.zeros(2)  # way and turn of the stretches so far, which are forgotten alike
        self._begin()

    def _begin(self) -> None:
        self._odometry, self._matched = np.zeros(3), np.zeros(3)
        self._moved, self._unseen, self._noise = np.zeros(3), np.zeros(3), np.zeros(3)

    @property
    def share(self) -> NDArray[np.float64]:
        """The learnt standard deviation along, across, and in heading, as a share of the first guess."""
        # At first, each variance up to twice the first guess is as likely as any other.
        weights = SHARES**2 * np.exp(self._likelihood - self._likelihood.max(axis=1, keepdims=True))
        share: NDArray[np.float64] = np.sqrt(weights @ SHARES**2 / weights.sum(axis=1))
        return share

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Return what was learnt."""
        stretch = (self._odometry, self._matched, self._moved, self._unseen, self._noise)
        return {
            "systematic": self.systematic.copy(),
            "covariance": self._covariance.copy(),
            "likelihood": self._likelihood.copy(),
            "stretch": np.array(stretch),
            "usual": self._usual.copy(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        if len(state.get("systematic", ())) != len(self.systematic):  # of an older version
            return
        self.systematic, self._covariance = np.array(state["systematic"]), np.array(state["covariance"])
        self._likelihood = np.array(state["likelihood"])
        self._odometry, self._matched, self._moved, self._unseen, self._noise = np.array(state["stretch"])
        self._usual = np.array(state.get("usual", np.zeros(2)))

    def corrected(self, step: ArrayLike) -> NDArray[np.float64]:
        """Return a step by odometry (x m, y m, heading rad) without its systematic errors.

        An error of the heading grows with the way, so half of it turns the way.
        """
        step = np.asarray(step, float)
        dx, dy, turn = _by_systematic(step) @ self.systematic
        corrected: NDArray[np.float64] = step + np.array(
            [dx - turn / 2 * step[1], dy + turn / 2 * step[0], turn]
        )
        return corrected

    def over(self, step: ArrayLike, moved: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return the standard deviation over a step (x m, y m, heading rad).

        It is at least what is not known yet of the systematic errors: a straight way teaches nothing of
        turns, and left turns beside way nothing of right ones. The first guess contains them.

        Args:
            step: Odometry's motion.
            moved: Length of the way, 0, and the sum of its turns, if the step has some in both directions.
        """
        moved = np.asarray(step if moved is None else moved, float)
        by = _by_systematic(np.asarray(step, float))
        unknown = np.sqrt(np.diag(by @ self._covariance @ by.T))
        deviation: NDArray[np.float64] = np.maximum(self.share * first_guess(moved), unknown)
        return deviation

    def learn(
        self, step: ArrayLike, matched: ArrayLike, moved: NDArray[np.float64], known: NDArray[np.float64]
    ) -> None:
        """Compare a step by odometry with the same by a match.

        Args:
            step: Odometry's motion.
            matched: The motion from where the map has the robot to a match that trusts odometry only like
                that of an unknown robot. One that trusts it more would confirm what it trusts.
            moved: Length of the way, 0, and the sum of its turns.
            known: For each axis the share of what is known of that match that comes from the sweep.
        """
        self._odometry = compose(self._odometry, step)
        self._matched = compose(self._matched, matched)
        self._unseen = self._unseen + moved.sum() * (1 - known)
        self._moved = self._moved + moved
        self._noise = self._noise + first_guess(moved) ** 2 * (1 - known)
        if self._moved[0] < STRETCH_M and self._moved[2] < STRETCH_RAD:
            return
        self._unseen /= self._moved.sum()
        self._compare(self._noise)
        self._begin()

    def _compare(self, noise: NDArray[np.float64]) -> None:
        """Learn from a stretch, with the variance of its matches."""
        seen = np.maximum(1 - self._unseen, LEAST_SEEN)
        off = relative(self.corrected(self._odometry), self._matched)
        off[2] = wrap_angle(off[2])
        # As in `corrected`: an error of the heading grows with the way, so half of it turns the way.
        off[:2] -= off[2] / 2 * np.array([-self._odometry[1], self._odometry[0]])
        guess = first_guess(self._moved)
        share = self.share
        random = (share * guess) ** 2
        noise = noise / seen**2 + random * self._unseen / seen
        most = CUT * np.sqrt(self.over(self._odometry, self._moved) ** 2 + noise)
        error = np.clip(off / seen, -most, most)
        by = _by_systematic(self._seen_motion(np.sqrt(random + noise)[2]))
        systematic = by @ self._covariance @ by.T
        variance = (SHARES * guess[:, None]) ** 2 + (noise + np.diag(systematic))[:, None]
        likelihood = -0.5 * (np.log(variance) + error[:, None] ** 2 / variance)
        self._likelihood = (1 - 1 / MEMORY) * self._likelihood + likelihood
        gain = self._covariance @ by.T @ np.linalg.inv(systematic + np.diag(random + noise))
        self.systematic = self.systematic + gain @ error
        remaining = (np.eye(4) - gain @ by) @ self._covariance
        self._covariance = remaining + (SYSTEMATIC - remaining) / MEMORY**2

    def _seen_motion(self, deviation_rad: float) -> NDArray[np.float64]:
        """Return a stretch's motion, as far as odometry and the matches both show it.

        A turn that differs by no more than noise from the usual curve counts as the usual one. Otherwise, the
        noise alone would seem to tell an error with each radian from one with each metre.

        Args:
            deviation_rad: Standard deviation of the difference between the two turns.
        """
        way_m = float(np.hypot(*self._odometry[:2]))
        turn_rad = _common(self._odometry, self._matched)[2]
        self._usual = (1 - 1 / MEMORY) * self._usual + [way_m, turn_rad]
        usual = np.array([0.0, 0.0, way_m * self._usual[1] / max(self._usual[0], STRETCH_M)])
        common = _common(self._odometry - usual, self._matched - usual)
        common[2] *= abs(common[2]) > UNUSUAL * deviation_rad
        return usual + common

    def interrupt(self) -> None:
        """Begin a new stretch, because the robot was found elsewhere."""
        self._begin()


def _common(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motion that both of two steps show: a turn that only one of them shows is noise."""
    common: NDArray[np.float64] = np.sign(one) * np.minimum(np.abs(one), np.abs(other))
    return np.where(one * other > 0, common, 0.0)


def _by_systematic(step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives of a step's error `(3, 4)` by scale, angle, rad per m and rad per rad."""
    dx, dy, turn = step
    return np.array([[dx, -dy, 0.0, 0.0], [dy, dx, 0.0, 0.0], [0.0, 0.0, np.hypot(dx, dy), turn]])


def first_guess(moved: ArrayLike) -> NDArray[np.float64]:
    """Return the standard deviation of an unknown robot's odometry over a motion (x m, y m, heading rad).

    It is roughly a tenth of the motion plus some slip, so that it also holds for an uncalibrated robot.
    """
    dx, dy, turn = np.abs(np.asarray(moved, float))
    distance = float(np.hypot(dx, dy))
    slip = np.clip((distance + turn) / WHOLE_SLIP, LEAST_SLIP, 1.0)
    across = 0.03 * slip + 0.1 * distance + 0.05 * turn
    return np.array([across, across, 0.02 * slip + 0.05 * distance + 0.1 * turn])
