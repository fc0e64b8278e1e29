"""How far apart two colours are for eyes that lack a kind of cone.

Protanopia and deuteranopia are simulated as in Machado, Oliveira and Fernandes, "A Physiologically-based
Model for Simulation of Color Vision Deficiency", IEEE Transactions on Visualization and Computer Graphics
15 (6), 2009: the matrices of severity 1.0, for linear RGB. Distances are CIEDE2000: Sharma, Wu and Dalal,
"The CIEDE2000 Color-Difference Formula", Color Research and Application 30 (1), 2005.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
EYES: dict[str, Floats] = {
    "no deficiency": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
"""From linear RGB of IEC 61966-2-1, D65."""
WHITE = TO_XYZ.sum(axis=1)


def apart(one: str, other: str, eyes: str = "no deficiency") -> float:
    """Return the distance (CIEDE2000) of two colours such as #c62828; 1 is just noticed side by side."""
    return ciede2000(lab_of(one, eyes), lab_of(other, eyes))


def lab_of(colour: str, eyes: str) -> Floats:
    """Return what eyes see of a colour, in CIELAB."""
    coded = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    x, y, z = (TO_XYZ @ np.clip(EYES[eyes] @ linear, 0, 1)) / WHITE
    fx, fy, fz = (np.cbrt(t) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116 for t in (x, y, z))
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


def ciede2000(one: Floats, other: Floats) -> float:
    """Return the distance of two colours in CIELAB; the names are those of the paper."""
    chroma_7 = np.mean([np.hypot(*one[1:]), np.hypot(*other[1:])]) ** 7
    a_scale = 1.5 - 0.5 * np.sqrt(chroma_7 / (chroma_7 + 25.0**7))
    (l1, a1, b1), (l2, a2, b2) = one * (1, a_scale, 1), other * (1, a_scale, 1)
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    has_hue = bool(c1 * c2)
    turn = (h2 - h1 + 180) % 360 - 180 if has_hue else 0.0
    if turn == -180 and h2 > h1:
        turn = 180.0
    dl, dc, dh = l2 - l1, c2 - c1, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2))
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    hue = (h1 + turn / 2) % 360 if has_hue else h1 + h2
    wave = sum(
        weight * np.cos(np.radians(times * hue + shift))
        for weight, times, shift in ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.20, 4, -63))
    )
    s_l = 1 + 0.015 * (lightness - 50) ** 2 / np.sqrt(20 + (lightness - 50) ** 2)
    s_c, s_h = 1 + 0.045 * chroma, 1 + 0.015 * chroma * (1 + wave)
    turning = 30 * np.exp(-(((hue - 275) / 25) ** 2))
    r_t = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(2 * turning))
    parts = dl / s_l, dc / s_c, dh / s_h
    return float(np.sqrt(sum(part**2 for part in parts) + r_t * parts[1] * parts[2]))
