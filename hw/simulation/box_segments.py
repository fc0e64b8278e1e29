"""Boxes as line segments."""

import numpy as np
from numpy.typing import NDArray


def box_segments(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the four sides of each box: (N, 4) corners in, (4 N, 4) segments out, m."""
    x1, y1, x2, y2 = boxes.T
    sides = [(x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])
