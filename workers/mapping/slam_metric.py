"""Measures how well an estimated trajectory agrees with relative poses that people verified.

The error of each relation is the difference between it and the trajectory's own relative pose; the result is
the mean and standard deviation of its absolute translation and rotation (Kümmerle et al., "On measuring the
accuracy of SLAM algorithms", Autonomous Robots 27, 2009). No common frame and no alignment is needed.

    python -m robbie_robots.workers.mapping.slam_metric trajectory.txt intel.relations [--json]
"""

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.planar_pose import relative, wrap_angle

TOLERANCE_S = 0.05
BAD_INPUT = 2


class BadInput(ValueError):
    """A trajectory or a file of relations that cannot be used."""


@dataclass(frozen=True)
class Score:
    """Errors over the relations used: mean and standard deviation of the absolute values."""

    translation_mean_m: float
    translation_sd_m: float
    rotation_mean_deg: float
    rotation_sd_deg: float
    relations_used: int
    relations_unmatched: int


def measure(
    trajectory: NDArray[np.float64], relations: NDArray[np.float64], tolerance_s: float = TOLERANCE_S
) -> Score:
    """Measure a trajectory against relations, interpolated at their stamps.

    Args:
        trajectory: `(M, 4)`: stamp (s), x (m), y (m), heading (rad), in recording order, which need not
            be that of the stamps.
        relations: `(R, 8)`: stamp 1, stamp 2 (s), dx, dy, dz (m), roll, pitch, yaw (rad) of the pose at
            stamp 2 in the frame of the pose at stamp 1.
        tolerance_s: Maximum time between the stamp of a relation and the nearest pose.

    Raises:
        BadInput: No relation has a pose at both of its stamps.
    """
    first, first_off = _poses_at(trajectory, relations[:, 0])
    second, second_off = _poses_at(trajectory, relations[:, 1])
    matched = (first_off <= tolerance_s) & (second_off <= tolerance_s)
    if not matched.any():
        raise BadInput(
            f"no relation has a pose within {tolerance_s} s of both its stamps; are these the same drive?"
        )
    seen = relative(first[matched], second[matched])
    error = relative(relations[matched][:, [2, 3, 7]], seen)
    translation, rotation = np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2]))
    return Score(
        float(translation.mean()),
        float(translation.std()),
        float(rotation.mean()),
        float(rotation.std()),
        int(matched.sum()),
        int((~matched).sum()),
    )


def _poses_at(
    trajectory: NDArray[np.float64], stamps: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Interpolate the trajectory's poses at stamps, and return the time (s) to the nearest measured pose.

    Poses with the same stamp keep their order: just before this stamp the first one counts, just after it
    the last one.
    """
    in_order = trajectory[np.argsort(trajectory[:, 0], kind="stable")]
    after = np.clip(np.searchsorted(in_order[:, 0], stamps), 0, len(in_order) - 1)
    before = np.where(in_order[after, 0] > stamps, np.maximum(after - 1, 0), after)
    since = stamps - in_order[before, 0]
    span = in_order[after, 0] - in_order[before, 0]
    share = np.divide(since, span, out=np.zeros_like(span), where=span > 0)
    step = in_order[after, 1:] - in_order[before, 1:]
    step[:, 2] = wrap_angle(step[:, 2])
    return in_order[before, 1:] + share[:, None] * step, np.minimum(np.abs(since), np.abs(span - since))


def read_table(path: Path, columns: int, meaning: str) -> NDArray[np.float64]:
    """Read lines of numbers `(N, columns)`. Empty lines and those that begin with # are ignored.

    Raises:
        BadInput: The file is missing, empty, or has a malformed line. The text names file and line.
    """
    rows = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(text) for text in line.split()]
        except ValueError as error:
            raise BadInput(f"{path}:{number}: {error}; expected: {meaning}") from error
        if len(row) != columns or not np.isfinite(row).all():
            raise BadInput(
                f"{path}:{number}: expected {columns} finite numbers ({meaning}), found {line.strip()!r}"
            )
        rows.append(row)
    if not rows:
        raise BadInput(f"{path}: has no lines; expected: {meaning}")
    return np.array(rows)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. Return the exit code: 0, or 2 for bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m robbie_robots.workers.mapping.slam_metric", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "trajectory", type=Path, help="lines 't x y theta' (s, m, m, rad), at the rate of odometry"
    )
    parser.add_argument("relations", type=Path, help="lines 't1 t2 dx dy dz roll pitch yaw'")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    try:
        score = measure(
            read_table(options.trajectory, 4, "t x y theta"),
            read_table(options.relations, 8, "t1 t2 dx dy dz roll pitch yaw"),
        )
    except BadInput as error:
        print(f"slam_metric: {error}", file=sys.stderr)
        return BAD_INPUT
    if score.relations_unmatched:
        print(
            f"slam_metric: WARNING: left out {score.relations_unmatched} relations, which have no pose "
            f"within {TOLERANCE_S} s of their stamps",
            file=sys.stderr,
        )
    print(json.dumps(asdict(score)) if options.json else _text(score))
    return 0


def _text(score: Score) -> str:
    return (
        f"translation {score.translation_mean_m:.3f} ± {score.translation_sd_m:.3f} m\n"
        f"rotation    {score.rotation_mean_deg:.3f} ± {score.rotation_sd_deg:.3f} deg\n"
        f"relations   {score.relations_used} used, {score.relations_unmatched} without a pose"
    )


if __name__ == "__main__":
    sys.exit(main())
