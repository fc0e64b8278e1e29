"""Points of laser scans and point clouds, and how they travel to the browser."""

import math

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import LaserScan, PointCloud2, PointField

STEP_M = 0.01
"""Resolution of what is sent; with 16 bits it reaches as far as 327 m."""
COORDINATES = ("x", "y", "z")
CODES = {PointField.FLOAT32: "f4", PointField.FLOAT64: "f8"}


def scan_points(scan: LaserScan) -> NDArray[np.float64]:
    """Return where the rays end that hit something: (N, 3), m, the scanner's frame."""
    ranges = np.asarray(scan.ranges, np.float64)
    hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges < scan.range_max)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(hit)
    x, y = ranges[hit] * np.cos(angles), ranges[hit] * np.sin(angles)
    return np.column_stack((x, y, np.zeros(len(x))))


def cloud_points(cloud: PointCloud2, limit: int) -> NDArray[np.float64]:
    """Return every so manieth point of a cloud: (N <= limit, 3), m, its frame; none if it makes no sense."""
    nothing = np.zeros((0, 3))
    fields = {field.name: field for field in cloud.fields}
    used = [fields[name] for name in COORDINATES if name in fields]
    if len(used) < len(COORDINATES) or any(field.datatype not in CODES for field in used):
        return nothing
    sizes = [int(CODES[field.datatype][1]) for field in used]
    fits = all(field.offset + size <= cloud.point_step for field, size in zip(used, sizes, strict=True))
    is_whole = cloud.width * cloud.point_step <= cloud.row_step
    if not fits or not is_whole or len(cloud.data) != cloud.height * cloud.row_step or not len(cloud.data):
        return nothing
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
    coordinates = np.column_stack(found).astype(np.float64)
    return coordinates[np.isfinite(coordinates).all(axis=1)]


def packed(points: NDArray[np.float64]) -> bytes:
    """Return points (N, 3), m, as the page's script reads them: in steps, 16 bits each."""
    return np.clip(np.rint(points / STEP_M), -32768, 32767).astype("<i2").tobytes()
