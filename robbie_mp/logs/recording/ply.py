"""Point clouds and laser scans as PLY files.

Source: G. Turk, The PLY Polygon File Format (Stanford, 1994): a header of text, then binary little-endian
vertices. `rgb` is PCL's: three bytes in the value of one field.
"""

import re
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from robbie_mp.logs.recording.errors import LogError
from robbie_mp.messages import LaserScan, Message, PointCloud2

CLOUD_TYPES = (PointCloud2.type_name, LaserScan.type_name)
KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's kinds of the datatypes of `PointField`."""
PLY_NAMES = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort",
    "i4": "int", "u4": "uint", "f4": "float", "f8": "double",
}  # fmt: skip
PACKED_COLOURS = ("rgb", "rgba")
UNSAFE = re.compile(r"\W")

Points = NDArray[Any]
"""A structured array, one field for each property."""


class NotPly(LogError, ValueError):
    """A message cannot be written as a PLY file; the text says why.

    Example scenarios:
      - a cloud whose points have no x, y and z
      - data that are shorter than the cloud's size says
    """


def ply(message: Message) -> bytes:
    """Return the PLY file of a `PointCloud2` or `LaserScan`, of whichever version.

    The points of a scan are those of beams with a return: within the ranges that the scanner states.

    Raises:
        NotPly: the message is no whole cloud.
    """
    is_scan = message.type_name == LaserScan.type_name
    points = _scan(cast(LaserScan, message)) if is_scan else _cloud(cast(PointCloud2, message))
    frame = UNSAFE.sub("_", cast(Any, message).header.frame_id)
    kinds = [(name, points.dtype[name].str.lstrip("<|")) for name in points.dtype.names or ()]
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame {frame}",
        f"element vertex {len(points)}",
        *(f"property {PLY_NAMES[kind]} {name}" for name, kind in kinds),
        "end_header\n",
    ]
    return "\n".join(head).encode("ascii", "replace") + points.tobytes()


def _scan(scan: LaserScan) -> Points:
    ranges = np.asarray(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        has_return = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    columns = {"x": ranges * np.cos(angles), "y": ranges * np.sin(angles), "z": np.zeros(len(ranges))}
    if len(scan.intensities) == len(ranges):
        columns["intensity"] = np.asarray(scan.intensities)
    return _packed({name: values[has_return].astype("<f4") for name, values in columns.items()})


def _cloud(cloud: PointCloud2) -> Points:
    if flaw := PointCloud2.flaw(cloud):
        raise NotPly(f"a cloud that is not well formed: {flaw}")
    columns: dict[str, NDArray[Any]] = {}
    for name, values in _fields(cloud):
        if name in columns:
            raise NotPly(f"a cloud with two fields {name!r}")
        columns[name] = values
    if not {"x", "y", "z"} <= set(columns):
        raise NotPly("a cloud whose points have no x, y and z")
    return _packed(columns)


def _fields(cloud: PointCloud2) -> Any:
    """Yield name and values of each property, little-endian."""
    data = np.asarray(cloud.data)
    rows = data.reshape(cloud.height, cloud.row_step)[:, : cloud.width * cloud.point_step]
    points = np.ascontiguousarray(rows).reshape(cloud.width * cloud.height, cloud.point_step)
    for field in cloud.fields:
        kind, count, name = KINDS[field.datatype], max(field.count, 1), UNSAFE.sub("_", field.name)
        size = np.dtype(kind).itemsize
        raw = np.ascontiguousarray(points[:, field.offset : field.offset + size * count])
        values = raw.view(f"{'>' if cloud.is_bigendian else '<'}{kind}").astype(f"<{kind}")
        if name in PACKED_COLOURS and size == 4 and count == 1:
            packed = values.view("<u4")[:, 0]
            for colour, shift in (("red", 16), ("green", 8), ("blue", 0)):
                yield colour, (packed >> shift & 0xFF).astype("u1")
            continue
        for index in range(count):
            yield (f"{name}_{index}" if count > 1 else name), values[:, index]


def _packed(columns: dict[str, NDArray[Any]]) -> Points:
    count = len(next(iter(columns.values())))
    points = np.empty(count, [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        points[name] = values
    return points
