"""The settings of a link, and a link alone."""

import pytest

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.link.wire import Endpoints, open_session
from robbie_mp.messages import LinkState
from robbie_mp.services.link import Link


@pytest.fixture(scope="module", autouse=True)
def zenoh_has_started() -> None:
    """Zenoh keeps some descriptors until the process ends; have it open them before any test looks."""
    open_session(Endpoints()).close()


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({}, "robot: required"),
        ({"robot": "red/blue"}, "cannot be called"),
        ({"robot": "red", "send": {"steady": ["Image"]}}, "there is no class 'steady'"),
        ({"robot": "red", "send": {"state": ["Image camera front"]}}, "with a space between"),
        ({"robot": "red", "accept": {"blue": [""]}}, "expected a type"),
    ],
)
def test_wrong_settings_are_explained(settings: dict[str, object], problem: str) -> None:
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(Link, settings)


def test_a_link_alone_shows_its_state() -> None:
    with ModuleHarness(Link, {"robot": "red", "listen": []}) as harness:
        harness.advance(1.1)
        state = harness.take(LinkState)[-1]
        assert state.robot == "red"
        assert state.peers == []
