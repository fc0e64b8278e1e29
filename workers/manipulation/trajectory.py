"""When an arm is where on its way: as fast as its joints' speeds and accelerations allow."""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CORNER_RAD = 0.2
"""The arm stops where its way turns by more than this in joint space."""


class Trajectory:
    """A way with times. The speed along each piece without corners is a trapezoid.

    Args:
        way: (N, joints), rad; at least one position.
        max_speed: (joints,) rad/s.
        max_acceleration: (joints,) rad/s².
    """

    def __init__(self, way: Floats, max_speed: Floats, max_acceleration: Floats) -> None:
        steps = np.diff(way, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        keep = lengths > 1e-9
        way = np.concatenate([way[:1], way[1:][keep]])
        self.way, lengths = way, lengths[keep]
        self._pieces: list[tuple[float, _Trapezoid, Floats, Floats]] = []
        directions = np.diff(way, axis=0) / lengths[:, None]
        turns = np.arccos(np.clip((directions[:-1] * directions[1:]).sum(axis=1), -1.0, 1.0))
        ends = [*(np.flatnonzero(turns > CORNER_RAD) + 1).tolist(), len(lengths)]
        begin, begin_s = 0, 0.0
        for end in ends if len(lengths) else []:
            fastest = np.abs(directions[begin:end]).max(axis=0)
            with np.errstate(divide="ignore"):
                speed = float((max_speed / fastest).min())
                acceleration = float((max_acceleration / fastest).min())
            along = np.concatenate([[0.0], np.cumsum(lengths[begin:end])])
            profile = _Trapezoid(float(along[-1]), speed, acceleration)
            self._pieces.append((begin_s, profile, along, way[begin : end + 1]))
            begin, begin_s = end, begin_s + profile.duration_s
        self.duration_s = begin_s

    def at(self, time_s: float) -> Floats:
        """Return the positions at a time since the beginning: (joints,); before and after, the arm stands."""
        if not self._pieces or time_s <= 0.0:
            return np.asarray(self.way[0])
        begin_s, profile, along, way = next(piece for piece in reversed(self._pieces) if piece[0] <= time_s)
        length = profile.length_at(time_s - begin_s)
        return np.array([np.interp(length, along, way[:, joint]) for joint in range(way.shape[1])])


class _Trapezoid:
    """Accelerates, drives at constant speed, and brakes, over a length."""

    def __init__(self, length: float, speed: float, acceleration: float) -> None:
        self.length = length
        self.acceleration = acceleration
        self.speed = min(speed, math.sqrt(length * acceleration))
        self.ramp_s = self.speed / acceleration
        self.duration_s = self.ramp_s + length / self.speed

    def length_at(self, time_s: float) -> float:
        if time_s < self.ramp_s:
            return 0.5 * self.acceleration * time_s**2
        left_s = self.duration_s - time_s
        if left_s <= 0.0:
            return self.length
        if left_s < self.ramp_s:
            return self.length - 0.5 * self.acceleration * left_s**2
        return self.speed * (time_s - self.ramp_s / 2)
