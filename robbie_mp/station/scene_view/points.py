"""Transforms points of scans and clouds to the map frame, thins them, and packs them for the browser."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import LaserScan, PointCloud2, PointField

STEP_M = 0.01
"""Resolution of sent points. With 16 bits, they reach as far as 327 m."""
COORDINATES = ("x", "y", "z")
INTENSITY = "intensity"
MAX_INTENSITY = 1e6
CODES = {PointField.FLOAT32: "f4", PointField.FLOAT64: "f8"}


class Points(NamedTuple):
    """Points of a scan or cloud, in the frame of its sensor."""

    places: NDArray[np.float64]
    """(N, 3), m."""
    intensities: NDArray[np.float64] | None
    """(N,), in the sensor's unit; None if it measures none."""

    def every(self, step: int) -> Points:
        """Return every second, third … point."""
        return Points(self.places[::step], None if self.intensities is None else self.intensities[::step])


NO_POINTS = Points(np.zeros((0, 3)), None)


def scan_points(scan: LaserScan) -> Points:
    """Return the ends of rays that hit something."""
    ranges = np.asarray(scan.ranges, np.float64)
    hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges < scan.range_max)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(hit)
    x, y = ranges[hit] * np.cos(angles), ranges[hit] * np.sin(angles)
    measured = np.asarray(scan.intensities, np.float64)
    intensities = measured[hit] if len(measured) == len(ranges) else None
    return Points(np.column_stack((x, y, np.zeros(len(x)))), intensities)


def cloud_points(cloud: PointCloud2, limit: int) -> Points:
    """Return a cloud's points, at most `limit`, thinned evenly; none if the cloud is malformed."""
    fields = {field.name: field for field in cloud.fields}
    used = [fields[name] for name in COORDINATES if name in fields]
    if len(used) < len(COORDINATES):
        return NO_POINTS
    if INTENSITY in fields and fields[INTENSITY].datatype in CODES:
        used.append(fields[INTENSITY])
    if any(field.datatype not in CODES for field in used):
        return NO_POINTS
    sizes = [int(CODES[field.datatype][1]) for field in used]
    fits = all(field.offset + size <= cloud.point_step for field, size in zip(used, sizes, strict=True))
    is_whole = cloud.width * cloud.point_step <= cloud.row_step
    if not fits or not is_whole or len(cloud.data) != cloud.height * cloud.row_step or not len(cloud.data):
        return NO_POINTS
    rows = np.asarray(cloud.data).reshape(cloud.height, cloud.row_step)
    points = rows[:, : cloud.width * cloud.point_step].reshape(-1, cloud.point_step)
    chosen = np.ascontiguousarray(points[:: max(1, math.ceil(len(points) / limit))])
    order = ">" if cloud.is_bigendian else "<"
    found = [
        np.ascontiguousarray(chosen[:, field.offset : field.offset + size]).view(
            order + CODES[field.datatype]
        )[:, 0]
        for field, size in zip(used, sizes, strict=True)
    ]
    numbers = np.column_stack(found).astype(np.float64)
    numbers = numbers[np.isfinite(numbers[:, :3]).all(axis=1)]
    return Points(numbers[:, :3], numbers[:, 3] if len(used) > len(COORDINATES) else None)


def shades(intensities: NDArray[np.float64] | None) -> bytes:
    """Return intensities as bytes, from 0 for the weakest to 255 for the strongest; b"" if there are none."""
    if intensities is None or not len(intensities):
        return b""
    sound = np.clip(np.nan_to_num(intensities), -MAX_INTENSITY, MAX_INTENSITY)
    weakest, strongest = sound.min(), sound.max()
    scaled: NDArray[np.float64] = (sound - weakest) * (255.0 / (strongest - weakest or 1.0))
    return np.rint(scaled).astype(np.uint8).tobytes()


def packed(points: NDArray[np.float64]) -> bytes:
    """Return points (N, 3), m, in the form that the page's script reads: steps of 16 bits each."""
    return np.clip(np.rint(points / STEP_M), -32768, 32767).astype("<i2").tobytes()
