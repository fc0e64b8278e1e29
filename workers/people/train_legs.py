"""Train the classifier of legs on labelled laser scans, and measure it on recordings that were held back.

    python -m robbie_robots.workers.people.train_legs --data FOLDER [--write FILE] [--json FILE]

The folder has files NAME.npz: `ranges_mm` (S, B) uint16, `angle_min`, `angle_increment`; recordings of people
also `leg_xy` (S, K, 2), the middles of legs, NaN where there are fewer. In a recording without `leg_xy` and
without people in its name, nothing is a leg. Scans of A. Leigh's leg_tracker (BSD-3-Clause) were used for the
model that comes with the project.

Each recording is held back once, while the others train; the figures come from these. The model that
`--write` writes is trained on all.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.people.leg_classifier import LegClassifier
from robbie_robots.workers.people.leg_segments import FEATURES, Segments, find_segments
from robbie_robots.workers.people.person_tracker import PersonTracker

Array = NDArray[np.float64]

MAX_RANGE_M = 6.0
MIN_RANGE_M = 0.02
"""Smaller values are codes of the laser for directions without a return."""
MATCH_M = 0.12
"""A segment is a labelled leg if its middle is this near."""
SCAN_S = 0.1
"""Time between two scans."""
PERSON_M, PERSON_S = 0.45, 0.4
"""A leg belongs to a tracked person that is this near, and was seen within this time."""
ROUNDS, RATE, BINS = 120, 0.15, 64
THRESHOLDS = (0.3, 0.5, 0.7)


@dataclass
class Recording:
    """The segments of a recording.

    Attributes:
        name: name of the file.
        features: (N, len(FEATURES)), of all segments that are labelled.
        is_leg: (N,).
        scans: number of scans.
        legs: number of labelled legs within range; those without a segment are counted, too.
        sweeps: the segments of each scan.
        labels: (S, K, 2), m, middles of legs; None if nothing is a leg.
    """

    name: str
    features: Array
    is_leg: NDArray[np.bool_]
    scans: int
    legs: int
    sweeps: list[Segments]
    labels: Array | None


def read(file: Path) -> Recording:
    """Read a recording and cut its scans into segments."""
    with np.load(file) as data:
        ranges = data["ranges_mm"].astype(np.float64) / 1000
        begin, step = float(data["angle_min"]), float(data["angle_increment"])
        labels = data["leg_xy"].astype(np.float64) if "leg_xy" in data else None
    ranges[ranges < MIN_RANGE_M] = np.inf
    features, is_leg, legs = [np.empty((0, len(FEATURES)))], [np.empty(0, np.bool_)], 0
    sweeps = [
        find_segments(LaserSweep.from_ranges(scan, begin, step, 0.0, np.inf), MAX_RANGE_M) for scan in ranges
    ]
    for index, segments in enumerate(sweeps):
        if labels is None:
            features.append(segments.features)
            is_leg.append(np.zeros(len(segments.features), np.bool_))
            continue
        marked = _marked(labels[index])
        legs += len(marked)
        if not len(marked) or not len(segments.centres_m):
            continue
        # Only the marked legs of these scans are known; what else was there is not.
        apart = np.hypot(*(marked[:, None] - segments.centres_m).transpose(2, 0, 1))
        nearest = np.unique(apart.argmin(axis=1)[apart.min(axis=1) <= MATCH_M])
        features.append(segments.features[nearest])
        is_leg.append(np.ones(len(nearest), np.bool_))
    return Recording(
        file.stem, np.concatenate(features), np.concatenate(is_leg), len(ranges), legs, sweeps, labels
    )


def _marked(labels: Array) -> Array:
    """Return the labelled legs of a scan that are within range."""
    marked: Array = labels[np.isfinite(labels).all(axis=1)]
    near: Array = marked[np.hypot(*marked.T) < MAX_RANGE_M]
    return near


def tracked(recording: Recording, classifier: LegClassifier) -> dict[str, float]:
    """Track the persons of a recording for which the laser stood still, and return the figures.

    Returns:
        Shares of the labelled legs that are near a tracked person, and near one that has moved; and the
        number of the latter in a scan.
    """
    tracker, near, near_moved, moved = PersonTracker(), 0, 0, 0
    assert recording.labels is not None
    for index, segments in enumerate(recording.sweeps):
        tracker.see(index * SCAN_S, segments.centres_m, classifier.probabilities(segments.features))
        persons = [one for one in tracker.persons if one.unseen_s <= PERSON_S]
        moved += sum(one.has_moved for one in persons)
        for leg in _marked(recording.labels[index]):
            beside = [one for one in persons if np.hypot(*(one.xy_m - leg)) <= PERSON_M]
            near += bool(beside)
            near_moved += any(one.has_moved for one in beside)
    return {
        "near_a_person": round(near / recording.legs, 3),
        "near_one_that_moved": round(near_moved / recording.legs, 3),
        "moved_in_a_scan": round(moved / recording.scans, 2),
    }


def train(features: Array, is_leg: NDArray[np.bool_]) -> dict[str, Any]:
    """Return a model: both classes weigh the same."""
    edges = [np.unique(np.quantile(column, np.linspace(0, 1, BINS)[1:-1])) for column in features.T]
    binned = np.column_stack(
        [np.searchsorted(edge, column, side="left") for edge, column in zip(edges, features.T, strict=True)]
    )
    wanted = is_leg.astype(np.float64)
    weight = np.where(is_leg, 0.5 / max(1, is_leg.sum()), 0.5 / max(1, (~is_leg).sum())) * len(wanted)
    score, trees = np.zeros(len(wanted)), []
    for _ in range(ROUNDS):
        probability = 1 / (1 + np.exp(-score))
        slope = weight * (wanted - probability)
        curve = weight * np.maximum(probability * (1 - probability), 1e-6)
        tree, gain = _tree(binned, edges, slope, curve)
        trees.append(tree)
        score += gain
    return {"features": list(FEATURES), "base": 0.0, "trees": trees}


def _tree(
    binned: NDArray[np.intp], edges: list[Array], slope: Array, curve: Array
) -> tuple[dict[str, Any], Array]:
    """Return the tree of depth two that fits best, and what it adds to each score."""
    everything = np.ones(len(slope), np.bool_)
    root = _split(binned, edges, slope, curve, everything)
    above = binned[:, root[0]] > root[1]
    tree: dict[str, list[Any]] = {"feature": [root[0]], "threshold": [_edge(edges, root)], "value": []}
    added = np.zeros(len(slope))
    for side in (~above, above):
        branch = _split(binned, edges, slope, curve, side)
        tree["feature"].append(branch[0])
        tree["threshold"].append(_edge(edges, branch))
        beyond = binned[:, branch[0]] > branch[1]
        for leaf in (side & ~beyond, side & beyond):
            value = RATE * float(slope[leaf].sum() / (curve[leaf].sum() + 1.0))
            tree["value"].append(round(value, 5))
            added[leaf] = value
    return tree, added


def _split(
    binned: NDArray[np.intp], edges: list[Array], slope: Array, curve: Array, within: NDArray[np.bool_]
) -> tuple[int, int]:
    """Return the feature and the bin after which a cut gains most."""
    best, found = -np.inf, (0, 0)
    for feature, edge in enumerate(edges):
        places = binned[within, feature]
        slopes = np.cumsum(np.bincount(places, slope[within], len(edge) + 1))
        curves = np.cumsum(np.bincount(places, curve[within], len(edge) + 1))
        left, right = slopes[:-1], slopes[-1] - slopes[:-1]
        gain = left**2 / (curves[:-1] + 1.0) + right**2 / (curves[-1] - curves[:-1] + 1.0)
        if len(gain) and gain.max() > best:
            best, found = float(gain.max()), (feature, int(gain.argmax()))
    return found


def _edge(edges: list[Array], split: tuple[int, int]) -> float:
    # No rounding: a value on the edge must fall on the same side as in training.
    return float(edges[split[0]][split[1]])


def held_back(recordings: list[Recording]) -> dict[str, Any]:
    """Return recall and false alarms on each recording, by a model that has not seen it."""
    figures: dict[str, Any] = {}
    for left_out in recordings:
        others = [one for one in recordings if one is not left_out]
        model = train(
            np.concatenate([one.features for one in others]), np.concatenate([one.is_leg for one in others])
        )
        classifier = LegClassifier(model)
        found = classifier.probabilities(left_out.features)
        figures[left_out.name] = {"scans": left_out.scans, "legs": left_out.legs} | {
            f"at_{limit}": round(float((found[left_out.is_leg] >= limit).sum() / left_out.legs), 3)
            if left_out.legs
            else round(float((found >= limit).sum() / left_out.scans), 2)
            for limit in THRESHOLDS
        }
        if left_out.legs:
            figures[left_out.name] |= tracked(left_out, classifier)
    return figures


def main(words: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m robbie_robots.workers.people.train_legs", description=__doc__
    )
    parser.add_argument("--data", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the model, trained on all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args(words)
    files = [*sorted(options.data.glob("legs_*.npz")), *sorted(options.data.glob("no_people*.npz"))]
    recordings = [read(file) for file in files]
    if not any(one.legs for one in recordings) or all(one.legs for one in recordings):
        print(f"{options.data} needs recordings legs_*.npz and no_people*.npz", file=sys.stderr)
        return 2
    figures = held_back(recordings)
    for name, row in figures.items():
        print(name, row)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    if options.write:
        model = train(
            np.concatenate([one.features for one in recordings]),
            np.concatenate([one.is_leg for one in recordings]),
        )
        model["source"] = "laser scans of A. Leigh's leg_tracker, BSD-3-Clause"
        options.write.write_text(json.dumps(model) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
