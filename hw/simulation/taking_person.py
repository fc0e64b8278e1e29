"""A simulated person who takes what a robot's hand holds out."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

STILL_M = 0.01
"""A hand stands if it has moved by at most this."""
REACTION_S = 1.0
"""Time after which a person takes hold of what a standing hand holds out."""
TUG_S = 0.8
"""A person pulls for this time, waits for as long, and pulls again."""


class TakingPerson:
    """The nearest person in reach takes hold of what the hand holds out once it stands, and tugs at it.

    Args:
        reach_m: a person takes what is this near, seen from above.
        pull_n: force of a tug.

    Attributes:
        has_hold: whether the person holds the object, too, and takes it when the hand lets it go.
    """

    def __init__(self, reach_m: float, pull_n: float) -> None:
        self._reach_m, self._pull_n = reach_m, pull_n
        self._stands_at: Floats | None = None
        self._since_s = 0.0
        self.has_hold = False

    def pull(self, now_s: float, hand: Floats | None, people: ArrayLike) -> Floats:
        """Return the force on the object: (3,), N.

        Args:
            now_s: the time.
            hand: (3,), m: where the hand is that holds something; None: it holds nothing.
            people: (P, 2), m.
        """
        self.has_hold = False
        if hand is None:
            self._stands_at = None
            return np.zeros(3)
        if self._stands_at is None or math.dist(hand, self._stands_at) > STILL_M:
            self._stands_at, self._since_s = hand.copy(), now_s
        away = np.asarray(people, np.float64).reshape(-1, 2) - hand[:2]
        distances = np.hypot(*away.T)
        stands_s = now_s - self._since_s
        if stands_s < REACTION_S or not (distances <= self._reach_m).any():
            return np.zeros(3)
        self.has_hold = True
        if (stands_s - REACTION_S) % (2 * TUG_S) >= TUG_S:
            return np.zeros(3)
        nearest = int(distances.argmin())
        return np.array([*(self._pull_n * away[nearest] / max(float(distances[nearest]), 1e-6)), 0.0])
