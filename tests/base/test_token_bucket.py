"""A token bucket lets a burst pass, then a fixed average rate."""

from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.base.token_bucket import TokenBucket


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.integers(0, 300)), min_size=1, max_size=30))
def test_no_more_pass_than_a_burst_and_the_rate(floods: list[tuple[float, int]]) -> None:
    now_s, passed = 100.0, 0
    limit = TokenBucket(per_s=50.0, burst=100, clock=lambda: now_s)
    for pause_s, count in floods:
        now_s += pause_s
        allowed = limit.take(count)
        passed += allowed
        assert allowed == count or allowed + 1 + 1e-6 > min(100.0, 50.0 * pause_s)
        assert passed <= 100 + 50.0 * (now_s - 100.0) + 1e-6


def test_who_spends_more_than_may_pass_waits_longer() -> None:
    now_s = 100.0
    bucket = TokenBucket(per_s=2.0, burst=3, clock=lambda: now_s)
    waits = []
    for _ in range(5):
        waits.append(bucket.wait_s)
        bucket.spend()
    assert waits == [0.0, 0.0, 0.0, 0.5, 1.0]
    assert bucket.take() == 0
    now_s += 1.5
    assert (bucket.wait_s, bucket.take()) == (0.0, 1)
