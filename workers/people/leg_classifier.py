"""Which segments of a laser scan are legs: boosted trees on the features of `leg_segments`.

After Arras, Mozos and Burgard (ICRA 2007), who boost stumps; here they are trees of depth two, boosted as in
Friedman, "Greedy function approximation: a gradient boosting machine" (Annals of Statistics, 2001).
`python -m robbie_robots.workers.people.train_legs` writes the file `legs.json` from labelled scans.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.people.leg_segments import FEATURES

Array = NDArray[np.float64]

MODEL = Path(__file__).with_name("legs.json")
MAX_TREES = 2000


class WrongLegModel(ValueError):
    """A file is not a model of this classifier."""


class LegClassifier:
    """Says how likely segments are legs.

    Args:
        model: `base`, a number; `trees`, a list of trees, each with `feature` (3), `threshold` (3) and
            `value` (4): the root and its two branches compare a feature with a threshold.

    Raises:
        WrongLegModel: the model has another form.
    """

    def __init__(self, model: Mapping[str, Any]) -> None:
        try:
            if tuple(model["features"]) != FEATURES:
                raise WrongLegModel("the leg model was trained on other features: train it again")
            trees = model["trees"]
            self._feature = np.array([tree["feature"] for tree in trees], np.intp).reshape(-1, 3)
            self._threshold = np.array([tree["threshold"] for tree in trees], np.float64).reshape(-1, 3)
            self._value = np.array([tree["value"] for tree in trees], np.float64).reshape(-1, 4)
            self._base = float(model["base"])
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, WrongLegModel):
                raise
            raise WrongLegModel(f"not a leg model: {type(error).__name__}: {error}") from error
        wrong_feature = self._feature.size and not 0 <= self._feature.min() <= self._feature.max() < len(
            FEATURES
        )
        if not 0 < len(trees) <= MAX_TREES or wrong_feature or not np.isfinite(self._value).all():
            raise WrongLegModel(f"a leg model has 1 to {MAX_TREES} trees on {len(FEATURES)} features")

    @classmethod
    def from_file(cls, file: Path = MODEL) -> "LegClassifier":
        """Read a model.

        Raises:
            WrongLegModel: the file is not a model.
            OSError: the file cannot be read.
        """
        try:
            model = json.loads(file.read_text())
        except ValueError as error:
            raise WrongLegModel(f"{file} is not JSON: {error}") from error
        if not isinstance(model, dict):
            raise WrongLegModel(f"{file} is not a leg model: expected a map")
        return cls(model)

    def probabilities(self, features: Array) -> Array:
        """Return how likely segments are legs.

        Args:
            features: (N, len(FEATURES)), as `find_segments` returns them.

        Returns:
            (N,), 0 to 1.
        """
        above = features[:, self._feature] > self._threshold  # (N, T, 3)
        leaf = np.where(above[:, :, 0], 2 + above[:, :, 2], 0 + above[:, :, 1])
        score = self._base + self._value[np.arange(len(self._value)), leaf].sum(axis=1)
        probability: Array = 1.0 / (1.0 + np.exp(-score))
        return probability
