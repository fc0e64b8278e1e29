"""The restart budget over any history, on a clock that the test sets."""

from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.run.profile.model import RestartPolicy, RestartWhen
from robbie_mp.run.supervisor.restart import JITTER_SHARE, GiveUp, LeaveStopped, Restart, RestartBudget

times_s = st.floats(0.0, 100.0)
policies = st.builds(
    RestartPolicy,
    policy=st.sampled_from(RestartWhen),
    max_restarts=st.integers(0, 6),
    within_s=st.floats(0.1, 60.0),
    backoff_s=st.floats(0.001, 10.0),
    backoff_cap_s=st.floats(0.001, 10.0),
    stable_after_s=st.floats(0.1, 30.0),
)


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def budget(clock: Clock, policy: RestartPolicy, jitter: float = 0.0) -> RestartBudget:
    return RestartBudget(policy, clock, lambda: jitter)


def fail_after(clock: Clock, tested: RestartBudget, running_s: float) -> Restart | GiveUp | LeaveStopped:
    tested.running()
    clock.now_s += running_s
    return tested.ended(clean=False)


def waits_of(count: int, policy: RestartPolicy) -> list[float]:
    tested = budget(Clock(), policy)
    verdicts = [tested.ended(clean=False) for _ in range(count)]
    return [verdict.after_s for verdict in verdicts if isinstance(verdict, Restart)]


def test_wait_doubles_up_to_the_cap() -> None:
    policy = RestartPolicy(max_restarts=9, backoff_s=0.5, backoff_cap_s=3.0)
    assert waits_of(5, policy) == [0.5, 1.0, 2.0, 3.0, 3.0]


def test_one_failure_more_than_the_budget_is_too_many() -> None:
    tested = budget(Clock(), RestartPolicy(max_restarts=2, within_s=60.0))
    assert isinstance(tested.ended(clean=False), Restart)
    assert isinstance(tested.ended(clean=False), Restart)
    assert tested.ended(clean=False) == GiveUp("all 2 restarts within 60 s are used up", 30.0)


def test_old_restarts_no_longer_count() -> None:
    clock = Clock()
    tested = budget(clock, RestartPolicy(max_restarts=1, within_s=60.0, backoff_s=2.0))
    assert isinstance(tested.ended(clean=False), Restart)
    clock.now_s = 62.0
    assert isinstance(tested.ended(clean=False), Restart)


def test_backoff_does_not_count_as_time_since_a_restart() -> None:
    clock = Clock()
    tested = budget(clock, RestartPolicy(max_restarts=1, within_s=60.0, backoff_s=2.0))
    assert isinstance(tested.ended(clean=False), Restart)
    clock.now_s = 61.9
    assert isinstance(tested.ended(clean=False), GiveUp)


def test_used_up_budget_allows_slow_retries_until_running_is_stable() -> None:
    clock = Clock()
    policy = RestartPolicy(max_restarts=1, within_s=60.0, backoff_s=1.0, stable_after_s=10.0, retry_s=25.0)
    tested = budget(clock, policy)
    assert fail_after(clock, tested, 0.1) == Restart(1.0)
    for _ in range(100):
        verdict = fail_after(clock, tested, 0.1)
        assert isinstance(verdict, GiveUp)
        assert verdict.retry_after_s == 25.0
        clock.now_s += verdict.retry_after_s
    assert fail_after(clock, tested, 10.0) == Restart(1.0)


def test_retry_interval_of_zero_means_no_retry() -> None:
    verdict = budget(Clock(), RestartPolicy(max_restarts=0, retry_s=0.0)).ended(clean=False)
    assert isinstance(verdict, GiveUp)
    assert verdict.retry_after_s is None


def test_device_that_is_away_for_8_s_is_found_again_with_the_defaults() -> None:
    """Even if a start that fails takes no time, and each wait is as short as chance can make it."""
    clock = Clock()
    tested = budget(clock, RestartPolicy(), jitter=1.0)
    while clock.now_s < 7.5:
        verdict = tested.ended(clean=False)
        assert isinstance(verdict, Restart), f"FAILED after {clock.now_s} s"
        clock.now_s += verdict.after_s


def test_stable_running_restores_the_budget_and_the_first_wait() -> None:
    clock = Clock()
    tested = budget(clock, RestartPolicy(max_restarts=2, backoff_s=1.0, stable_after_s=10.0))
    assert fail_after(clock, tested, 0.1) == Restart(1.0)
    assert fail_after(clock, tested, 0.1) == Restart(2.0)
    assert fail_after(clock, tested, 10.0) == Restart(1.0)
    assert fail_after(clock, tested, 0.1) == Restart(2.0)


def test_start_up_and_backoff_do_not_count_as_stable_running() -> None:
    clock = Clock()
    tested = budget(clock, RestartPolicy(max_restarts=1, within_s=1000.0, stable_after_s=10.0))
    tested.ended(clean=False)
    clock.now_s += 100.0  # never told that it runs
    assert isinstance(tested.ended(clean=False), GiveUp)


def test_only_policy_always_restarts_after_a_clean_end() -> None:
    for when in RestartWhen:
        verdict = budget(Clock(), RestartPolicy(policy=when)).ended(clean=True)
        assert isinstance(verdict, Restart) == (when is RestartWhen.ALWAYS)
        assert isinstance(verdict, LeaveStopped) == (when is not RestartWhen.ALWAYS)


def test_failure_is_final_with_policy_never() -> None:
    verdict = budget(Clock(), RestartPolicy(policy=RestartWhen.NEVER)).ended(clean=False)
    assert isinstance(verdict, GiveUp)


@given(
    policies,
    st.lists(st.tuples(times_s, times_s, st.booleans()), max_size=40),
    st.floats(0.0, 1.0, exclude_max=True),
)
def test_no_history_gets_more_restarts_than_the_budget(
    policy: RestartPolicy, history: list[tuple[float, float, bool]], jitter: float
) -> None:
    clock = Clock()
    tested = budget(clock, policy, jitter)
    restarts_s: list[float] = []  # since the last stable running
    is_used_up = False
    for starting_s, running_s, clean in history:
        clock.now_s += starting_s
        tested.running()
        since_s = clock.now_s
        clock.now_s += running_s
        if clock.now_s - since_s >= policy.stable_after_s:
            restarts_s.clear()
            is_used_up = False
        verdict = tested.ended(clean=clean)
        recent = [at_s for at_s in restarts_s if clock.now_s - at_s < policy.within_s]
        if isinstance(verdict, Restart):
            assert policy.policy is not RestartWhen.NEVER
            assert len(recent) < policy.max_restarts
            assert not is_used_up
            full_s = min(policy.backoff_s * 2 ** len(restarts_s), policy.backoff_cap_s)
            assert (1.0 - JITTER_SHARE) * full_s <= verdict.after_s <= full_s
            clock.now_s += verdict.after_s
            restarts_s.append(clock.now_s)
        elif isinstance(verdict, GiveUp):
            assert policy.policy is RestartWhen.NEVER or is_used_up or len(recent) == policy.max_restarts
            is_used_up = policy.policy is not RestartWhen.NEVER
        else:
            assert clean
