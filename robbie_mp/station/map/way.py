"""The way that a robot drives, or may drive, for pages."""

from robbie_mp.messages import Path


def way_points(path: Path | None, most: int) -> list[list[float]]:
    """Return x and y (m) of the points of a path.

    Args:
        path: None: there is none.
        most: maximum number of points, but for the last. Of more, every second, third … is returned.
    """
    poses = path.poses if path else []
    every = -(-len(poses) // most) or 1
    positions = [one.pose.position for one in (*poses[:-1:every], *poses[-1:])]
    return [[round(one.x, 3), round(one.y, 3)] for one in positions]
