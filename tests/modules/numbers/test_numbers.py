"""The modules of the numbered signs: what they tell one another, and what they keep over a restart."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from modules.numbers import signs as signs_module
from modules.numbers.messages import NumberSigns, SignsReached
from modules.numbers.mission import Numbers
from modules.numbers.referee import Referee
from modules.numbers.signs import NumberSignFinder
from robbie_mp import ModuleHarness, SettingError
from robbie_mp.messages import Odometry, Point, Pose, PoseWithCovariance, Quaternion
from tests._support.places import ARENAS
from workers.numbers.digit_reader import ReaderMissing

SMALL = ARENAS / "numbers_small.yaml"


def truth(x_m: float, y_m: float, heading_rad: float) -> Odometry:
    """The true pose, from the start, which is at (3.5, 3.5)."""
    place = Pose(position=Point(x=x_m - 3.5, y=y_m - 3.5), orientation=Quaternion.from_yaw(heading_rad))
    return Odometry(pose=PoseWithCovariance(pose=place))


def test_referee_judges_each_visit_where_the_robot_truly_is() -> None:
    with ModuleHarness(Referee, {"arena": str(SMALL)}) as referee:
        referee.send(truth(5.9, 5.1, 0.8), topic="ground_truth")
        referee.send(SignsReached(digits=np.array([4], np.uint8)))
        referee.advance(1.0)
        referee.send(truth(3.0, 3.0, 0.0), topic="ground_truth")
        referee.send(SignsReached(digits=np.array([4, 1], np.uint8)))
        referee.advance(1.0)
        assert [visit.counts for visit in referee.module.visits] == [True, False]
        assert referee.module.visits[0].distance_m == pytest.approx(math.hypot(0.7, 0.7))
        kept = referee.checkpoint
    with ModuleHarness(Referee, {"arena": str(SMALL)}, restored=kept) as referee:
        # The newest message is latched: the restarted referee gets it again.
        referee.send(truth(3.0, 3.0, 0.0), topic="ground_truth")
        referee.send(SignsReached(digits=np.array([4, 1], np.uint8)))
        referee.advance(1.0)
        assert [visit.digit for visit in referee.module.visits] == [4, 1]


def test_missing_reader_is_named_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ReaderMissing("digits are read with rapidocr-onnxruntime: install it (extra 'digits')")

    monkeypatch.setattr(signs_module, "BoardReader", missing)
    with pytest.raises(SettingError, match="extra 'digits'"):
        NumberSignFinder.check({})


def test_mission_takes_signs_and_writes_its_results(tmp_path: Path) -> None:
    with ModuleHarness(Numbers, output_directory=tmp_path) as mission:
        mission.send(
            NumberSigns(
                x_m=np.array([1.0, 2.0, 3.0]),
                y_m=np.zeros(3),
                facing_rad=np.full(3, np.nan),
                digits=np.array([7, NumberSigns.UNKNOWN, NumberSigns.OTHER], np.int8),
                likely=np.array([7, 3, NumberSigns.UNKNOWN], np.int8),
                views=np.array([5, 1, 0], np.uint16),
                searched=np.array([1, 2, 4095], np.uint16),
                sheet="70",
                images=5,
            )
        )
        reports = mission.module.mission.signs
        assert [(one.digit, one.is_open) for one in reports] == [(7, False), (None, True), (None, False)]
        assert [(one.likely, one.views, one.searched) for one in reports] == [
            (7, 5, 1),
            (3, 1, 2),
            (None, 0, 4095),
        ]
        mission.advance(1.0)
        assert mission.module.status.endswith("sees 7")
        mission.module.teardown()
        assert json.loads((tmp_path / "numbers.json").read_text())["reached"] == []
