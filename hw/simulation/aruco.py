"""The fifty tags of the ArUco dictionary 4x4_50, as in OpenCV.

Source: DICT_4X4_50 in OpenCV's `objdetect/src/aruco/predefined_dictionaries.hpp`; made by the method of
Garrido-Jurado et al., Automatic generation and detection of highly reliable fiducial markers under occlusion,
Pattern Recognition 47 (2014).
"""

import numpy as np
from numpy.typing import NDArray

# Sixteen bits each, row by row from the upper left, 1 is white.
# fmt: off
PATTERNS = (
    0xB532, 0x0F9A, 0x332D, 0x9946, 0x549E, 0x79CD, 0x9E2E, 0xC4F2, 0xFEDA, 0xCF56,
    0xF991, 0x11A7, 0x0EB7, 0x2A0F, 0x24B1, 0x263E, 0x4665, 0x6600, 0x6C5E, 0x76AF,
    0x868B, 0xB02B, 0xCCD5, 0xDD82, 0xFE47, 0x9471, 0xACE4, 0xA554, 0x2123, 0x346F,
    0x4415, 0x57B2, 0x9ECF, 0xF0CB, 0x08AE, 0x0929, 0x1875, 0x04FF, 0x0DF6, 0x1C5A,
    0x1718, 0x2A28, 0x328C, 0x38B2, 0x24E8, 0x2EEB, 0x2D3F, 0x4B64, 0x502E, 0x5013,
)
# fmt: on
TAG_COUNT = len(PATTERNS)


def tag_cells(tag: int) -> NDArray[np.bool_]:
    """Return a tag with its black border: (6, 6), True is white.

    Raises:
        ValueError: the dictionary has no such tag.
    """
    if not 0 <= tag < TAG_COUNT:
        raise ValueError(f"tag must be from 0 to {TAG_COUNT - 1}, not {tag}")
    bits = [PATTERNS[tag] >> (15 - place) & 1 for place in range(16)]
    return np.pad(np.array(bits, dtype=np.bool_).reshape(4, 4), 1)
