"""Errors can be sent to another process, as `concurrent.futures` and `multiprocessing` do."""

import copy
import importlib
import pickle
import pkgutil
from collections.abc import Iterator

import pytest

import robbie_mp
from robbie_mp import RobbieError, SettingError
from robbie_mp.base.linux.forks import ForkedProcess
from robbie_mp.base.problem import Problem, ProfileError
from robbie_mp.messages import IllFormed
from robbie_mp.messages.codec.fields import DamageError
from robbie_mp.module.subscriptions import EmptyPattern, SubscribedTwice
from robbie_mp.module.wiring import TopicsMeet
from robbie_mp.scene.errors import SceneFileError, TooNew, TooOld, UnknownNode
from robbie_mp.station.panels.composer import FormError

PROBLEMS = [Problem("one"), Problem("two")]
WITH_CONSTRUCTORS = [
    SubscribedTwice("std_msgs/msg/String", "talk"),
    EmptyPattern(),
    DamageError("3 bytes are missing", 12, "data"),
    IllFormed("the position is NaN", "geometry_msgs/msg/Point", "x"),
    TopicsMeet("std_msgs/msg/String", "left", "right", "camera"),
    ForkedProcess(),
    ProfileError(PROBLEMS),
    SceneFileError(PROBLEMS),
    UnknownNode("there is no lasser", "lasser", ["laser"]),
    TooOld("too old", 0.5),
    TooNew("too new", 0.5),
    FormError({"x": "not a number"}),
    SettingError("too large", "speed"),
]


def all_errors(of: type[RobbieError] = RobbieError) -> Iterator[type[RobbieError]]:
    for derived in of.__subclasses__():
        yield derived
        yield from all_errors(derived)


@pytest.mark.parametrize("error", WITH_CONSTRUCTORS, ids=lambda error: type(error).__name__)
def test_error_with_its_own_constructor_can_be_pickled(error: RobbieError) -> None:
    for there in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
        assert type(there) is type(error)
        assert (str(there), there.args, vars(there)) == (str(error), error.args, vars(error))


def test_list_here_covers_every_error_with_a_constructor() -> None:
    for module in pkgutil.walk_packages(robbie_mp.__path__, "robbie_mp."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    own = {error for error in all_errors() if error.__module__.startswith("robbie_mp.")}
    assert {error for error in own if "__init__" in vars(error)} == set(map(type, WITH_CONSTRUCTORS))
    for error in own - set(map(type, WITH_CONSTRUCTORS)):
        there = pickle.loads(pickle.dumps(error("some text")))
        assert (type(there), str(there)) == (error, "some text")
