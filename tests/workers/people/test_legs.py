"""Segments of scans have the features of what they show, and the classifier finds legs among them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.people.leg_classifier import MODEL, LegClassifier, WrongLegModel
from robbie_robots.workers.people.leg_segments import FEATURES, Segments, find_segments
from robbie_robots.workers.people.train_legs import held_back, main, read, train

STEP_RAD = math.tau / 1024
REAL = Path(__file__).parents[4] / "shared" / "data" / "home" / "laser"
needs_recordings = pytest.mark.skipif(not REAL.is_dir(), reason=f"the recordings of legs are not in {REAL}")


def scan_of(*circles: tuple[float, float, float], wall_x_m: float = 6.0) -> NDArray[np.float64]:
    """Ranges of a laser in front of a wall, with round things x, y, radius."""
    angles = -math.pi + STEP_RAD * np.arange(1024)
    with np.errstate(divide="ignore"):
        ranges = np.where(np.cos(angles) > 0.05, wall_x_m / np.cos(angles), np.inf)
    for x, y, radius in circles:
        along = x * np.cos(angles) + y * np.sin(angles)
        half = radius**2 - (x**2 + y**2 - along**2)
        hit = (half >= 0) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(half[hit]))
    return ranges + np.random.default_rng(0).normal(0.0, 0.004, 1024)


def segments_of(ranges: NDArray[np.float64]) -> Segments:
    return find_segments(LaserSweep.from_ranges(ranges, -math.pi, STEP_RAD, 0.0, np.inf), 5.0)


def test_segment_of_a_round_thing_tells_its_middle_radius_and_width() -> None:
    segments = segments_of(scan_of((1.5, 0.4, 0.06)))
    assert len(segments.centres_m) == 1
    np.testing.assert_allclose(segments.centres_m[0], (1.5, 0.4), atol=0.03)
    feature = dict(zip(FEATURES, segments.features[0], strict=True))
    assert feature["circle_radius_m"] == pytest.approx(0.06, abs=0.02)
    assert 0.09 < feature["width_m"] < 0.13
    assert feature["range_m"] == pytest.approx(1.52, abs=0.03)
    assert (feature["jump_before_m"], feature["jump_after_m"]) == (1.0, 1.0)
    assert feature["convexity_m"] > 0.01


def test_thing_behind_the_robot_is_not_cut_where_a_full_scan_begins() -> None:
    segments = segments_of(scan_of((-1.5, 0.0, 0.06)))
    assert len(segments.centres_m) == 1
    np.testing.assert_allclose(segments.centres_m[0], (-1.5, 0.0), atol=0.03)


def test_wide_and_far_things_and_an_empty_scan_have_no_segments() -> None:
    assert len(segments_of(scan_of((2.0, 0.0, 0.5))).centres_m) == 0
    assert len(segments_of(scan_of((5.5, 0.0, 0.06))).centres_m) == 0
    assert segments_of(np.full(1024, np.inf)).features.shape == (0, len(FEATURES))
    assert segments_of(np.full(1024, np.nan)).features.shape == (0, len(FEATURES))


def test_too_near_return_beside_a_segment_hides_it_and_no_return_does_not() -> None:
    for beside, jump in ((-np.inf, -1.0), (np.inf, 1.0), (np.nan, 1.0)):
        ranges = scan_of((1.5, 0.0, 0.06))
        beams = np.flatnonzero(ranges < 1.6)
        ranges[beams[0] - 3 : beams[0]] = beside
        assert segments_of(ranges).features[0, FEATURES.index("jump_before_m")] == jump


def test_shipped_model_takes_legs_for_legs_and_a_pillar_for_none() -> None:
    segments = segments_of(scan_of((1.5, 0.1, 0.06), (1.5, -0.1, 0.06), (2.0, 2.0, 0.16)))
    probability = LegClassifier.from_file().probabilities(segments.features)
    is_leg = np.abs(segments.centres_m[:, 1]) < 0.3
    assert is_leg.tolist().count(True) == 2
    assert probability[is_leg].min() > 0.5 > probability[~is_leg].max()


@pytest.mark.parametrize(
    "change",
    [
        {"trees": []},
        {"features": ["height"]},
        {"base": "much"},
        {"trees": [{"feature": [0, 1, 99], "threshold": [0, 0, 0], "value": [0, 0, 0, 0]}]},
        {"trees": [{"feature": [0], "threshold": [0], "value": [0]}]},
        {"trees": [{"feature": [0, 1, 2], "threshold": [0, 0, 0], "value": [0, 0, 0, float("nan")]}]},
    ],
)
def test_wrong_model_is_a_clear_error(change: dict[str, object]) -> None:
    with pytest.raises(WrongLegModel):
        LegClassifier(json.loads(MODEL.read_text()) | change)


def test_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    (tmp_path / "legs.json").write_text("[")
    with pytest.raises(WrongLegModel, match=r"legs\.json is not JSON"):
        LegClassifier.from_file(tmp_path / "legs.json")


def write_recordings(folder: Path) -> None:
    """Scans in which a leg of 6 cm radius walks past, and scans with pillars of 14 cm."""
    random = np.random.default_rng(2)
    legs, things, labels = [], [], []
    for index in range(30):
        walking = (1.0 + 0.06 * index, 0.3)
        legs.append(scan_of((*walking, 0.06)))
        labels.append([walking])
        things.append(scan_of((random.uniform(1.0, 3.0), random.uniform(-1.0, 1.0), 0.14)))
    for name, scans in (("legs_1", legs), ("legs_2", legs), ("no_people_1", things), ("no_people_2", things)):
        millimetres = np.nan_to_num(np.array(scans) * 1000, posinf=0.0).astype(np.uint16)
        content = {
            "ranges_mm": millimetres,
            "angle_min": np.array(-math.pi),
            "angle_increment": np.array(STEP_RAD),
        }
        if name.startswith("legs"):
            content["leg_xy"] = np.array(labels, np.float32)
        np.savez(folder / f"{name}.npz", **content)  # type: ignore[arg-type]


def test_training_learns_what_is_labelled_and_measures_it_on_what_was_held_back(tmp_path: Path) -> None:
    write_recordings(tmp_path)
    assert (
        main(
            [
                "--data",
                str(tmp_path),
                "--write",
                str(tmp_path / "model.json"),
                "--json",
                str(tmp_path / "f.json"),
            ]
        )
        == 0
    )
    figures = json.loads((tmp_path / "f.json").read_text())
    assert figures["legs_1"]["at_0.5"] > 0.9
    assert figures["no_people_1"]["at_0.5"] < 0.1
    assert figures["legs_1"]["near_one_that_moved"] > 0.5
    assert figures["legs_1"]["moved_in_a_scan"] < 1.0
    legs = read(tmp_path / "legs_1.npz")
    assert (legs.scans, legs.legs, legs.is_leg.sum()) == (30, 30, 30)
    assert LegClassifier.from_file(tmp_path / "model.json").probabilities(legs.features).min() > 0.5


def test_training_without_both_kinds_of_recordings_is_refused(tmp_path: Path) -> None:
    assert main(["--data", str(tmp_path)]) == 2


@pytest.mark.slow
@needs_recordings
def test_model_trained_on_some_real_recordings_finds_legs_in_another_one() -> None:
    others = [
        read(REAL / f"{name}.npz") for name in ("legs_positive_3", "legs_positive_4", "no_people_left_scan")
    ]
    left_out = [read(REAL / f"{name}.npz") for name in ("legs_positive_1", "no_people_right_scan")]
    model = train(
        np.concatenate([one.features for one in others]), np.concatenate([one.is_leg for one in others])
    )
    legs, none = (LegClassifier(model).probabilities(one.features) >= 0.5 for one in left_out)
    assert legs[left_out[0].is_leg].sum() / left_out[0].legs > 0.75
    assert none.sum() / left_out[1].scans < 6.0
    assert held_back([]) == {}
