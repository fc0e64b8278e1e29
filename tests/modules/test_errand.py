"""An errand is sent, sent again after an accident, and forgotten when it is not wanted any more."""

from collections.abc import Iterator

import pytest

from robbie_mp import CallError, Goal, GoalAborted, Module, ModuleHarness, Request, setting
from robbie_mp.messages import GoalCancel, NavigateTo, NavigationFeedback, NavigationResult
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.home.messages import FollowOrder, FollowOrderTaken

Asked = tuple[str, Request[FollowOrderTaken] | Goal[NavigationFeedback, NavigationResult]]


class Client(Module):
    """Wants what its test says."""

    period_s: float = setting(0.1, "time between looks")

    def setup(self) -> None:
        self.errand = Errand(self)
        self.asked: Asked | None = None
        self.ends: list[object] = []
        self.fed_back: list[NavigationFeedback] = []

    def tick(self) -> None:
        if self.asked is None:
            self.errand.drop("enough")
        else:
            self.errand.want(*self.asked, self.ends.append, self.on_failed, self.fed_back.append)

    def on_failed(self, error: CallError) -> None:
        self.ends.append(str(error))


FOLLOW, DRIVE = FollowOrder(order="follow"), NavigateTo(place="desk")


@pytest.fixture
def client() -> Iterator[ModuleHarness[Client]]:
    with ModuleHarness(Client) as harness:
        yield harness


def test_request_is_sent_once_and_its_end_is_reported(client: ModuleHarness[Client]) -> None:
    client.module.asked = "follow", FOLLOW
    client.advance(1.5)
    (sent,) = client.take(FollowOrder)
    client.reply(sent, FollowOrderTaken(changed=True))
    assert client.module.ends == [FollowOrderTaken(call=sent.call, changed=True)]
    client.advance(0.2)
    assert client.take(FollowOrder)  # it is still wanted


def test_what_an_accident_has_ended_is_sent_again_but_not_at_once(client: ModuleHarness[Client]) -> None:
    client.module.asked = "drive", DRIVE
    client.advance(0.2)
    assert client.take(NavigateTo)
    client.kill_server()
    client.advance(0.5)
    assert not client.take(NavigateTo)
    client.advance(1.0)
    assert client.take(NavigateTo)
    assert client.module.ends == []


def test_judgement_is_reported_and_other_errands_are_sent_at_once(client: ModuleHarness[Client]) -> None:
    client.module.asked = "drive", DRIVE
    client.advance(0.2)
    client.end_goal(client.take(NavigateTo)[0], GoalAborted("there is no way"))
    client.advance(0.2)
    assert client.module.ends == ["there is no way"]
    client.module.asked = "drive elsewhere", NavigateTo(place="sofa")
    client.advance(0.2)
    (goal,) = client.take(NavigateTo)
    client.feed_back(goal, NavigationFeedback(state="DRIVE"))
    assert [told.state for told in client.module.fed_back] == ["DRIVE"]


def test_what_is_not_wanted_any_more_is_cancelled_and_its_end_is_not_reported(
    client: ModuleHarness[Client],
) -> None:
    client.module.asked = "drive", DRIVE
    client.advance(0.2)
    (goal,) = client.take(NavigateTo)
    client.module.asked = None
    client.advance(0.2)
    assert [cancel.reason for cancel in client.take(GoalCancel)] == ["enough"]
    client.end_goal(goal, NavigationResult())
    assert client.module.ends == []
