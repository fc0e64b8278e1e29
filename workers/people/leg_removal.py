"""Scans without what may be legs, for a map on which nobody who stands still remains.

One sweep that shows a leg is enough to put it on a map, and no beam looks through it later. So a leg must be
left out in each scan, also where the classifier does not know it: a leg half hidden by the other one, its
last beam beyond a gap, and legs too far away for the scans by which the classifier was trained.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.people.leg_classifier import LegClassifier
from robbie_robots.workers.people.leg_segments import Pieces, cut_scan, find_segments

NARROW_M = 0.35
"""Wider pieces of a scan are neither a leg nor two legs side by side."""
BESIDE_M = 0.4
"""What is narrow and this near to a leg may be the other leg of the person."""
STANDS_OUT_M, IS_HIDDEN_M = 0.25, 1.0
"""Beside a far person, the background is farther away by this; or one thing beside it is nearer by that."""


def without_legs(
    classifier: LegClassifier, sweep: LaserSweep, *, probability: float, known_range_m: float
) -> LaserSweep:
    """Return a sweep in which beams on what may be legs were not measured.

    Args:
        classifier: says what may be legs.
        sweep: the sweep.
        probability: things less likely legs are kept, unless they are narrow and beside a leg.
        known_range_m: farther away, everything narrow that stands by itself may be a leg.
    """
    segments, pieces = find_segments(sweep, np.inf), cut_scan(sweep, np.inf)
    things = cut_scan(sweep, np.inf, gap_m=STANDS_OUT_M)
    legs = np.concatenate(
        [
            segments.centres_m[classifier.probabilities(segments.features) >= probability],
            things.middles_m[_stands_alone(things) & (np.hypot(*things.middles_m.T) > known_range_m)],
        ]
    )
    if not len(legs):
        return sweep
    ranges = sweep.ranges_m.copy()
    beside = np.hypot(*np.moveaxis(pieces.middles_m[:, None] - legs, -1, 0)).min(axis=1) <= BESIDE_M
    for first, last in pieces.ends[beside & (pieces.widths_m <= NARROW_M)].tolist():
        ranges[pieces.beams[first : last + 1]] = np.nan
    return replace(sweep, ranges_m=ranges)


def _stands_alone(things: Pieces) -> NDArray[np.bool_]:
    """Return which things have nothing beside them, unless it hides a part of them: (S,)."""
    stands_out, is_hidden = things.jumps_m >= STANDS_OUT_M, things.jumps_m <= -IS_HIDDEN_M
    alone = np.logical_and.reduce(stands_out | is_hidden) & np.logical_or.reduce(stands_out)
    stands: NDArray[np.bool_] = alone & (things.widths_m <= NARROW_M)
    return stands
