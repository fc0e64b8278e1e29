"""The robot's trajectory at the rate of odometry, corrected at the matched sweeps."""

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.planar_pose import compose, relative, wrap_angle

METRES_PER_RADIAN = 0.5  # weight of a turn against driving in odometry's error


def corrected(
    odometry: NDArray[np.float64],
    anchor_rows: NDArray[np.float64],
    anchor_odometry: NDArray[np.float64],
    anchor_poses: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Correct the odometry's poses by anchors, whose corrected poses are known.

    Between two anchors, odometry gives each pose twice: forwards from the anchor before, backwards from the
    one after. The two are blended by the distance moved, which spreads odometry's error over the motion.

    Args:
        odometry: `(M, 3)`, odometry frame.
        anchor_rows: `(A,)` ascending: each anchor's row in `odometry`; a fraction lies between two rows.
        anchor_odometry: `(A, 3)`, odometry's pose at each anchor, odometry frame.
        anchor_poses: `(A, 3)`, the corrected pose at each anchor, map frame.

    Returns:
        `(M, 3)`, map frame. Before the first anchor and after the last, that anchor alone counts.
    """
    rows = np.arange(len(odometry))
    after = np.searchsorted(anchor_rows, rows)
    before = np.maximum(after - 1, 0)
    after = np.minimum(after, len(anchor_rows) - 1)
    onward = compose(anchor_poses[before], relative(anchor_odometry[before], odometry))
    back = compose(anchor_poses[after], relative(anchor_odometry[after], odometry))
    moved = _moved(odometry)
    at_anchor = np.interp(anchor_rows, rows, moved)
    span = at_anchor[after] - at_anchor[before]
    share = np.divide(moved - at_anchor[before], span, out=np.zeros_like(span), where=span > 0)[:, None]
    apart = back - onward
    apart[:, 2] = wrap_angle(apart[:, 2])
    blended = onward + np.clip(share, 0, 1) * apart
    blended[:, 2] = wrap_angle(blended[:, 2])
    return blended


def _moved(odometry: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance moved up to each row (m), strictly ascending."""
    step = np.diff(odometry, axis=0)
    length = np.hypot(step[:, 0], step[:, 1]) + METRES_PER_RADIAN * np.abs(wrap_angle(step[:, 2])) + 1e-9
    return np.concatenate([[0.0], np.cumsum(length)])
