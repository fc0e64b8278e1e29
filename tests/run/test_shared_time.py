"""Several runs share one simulated time: none runs ahead of the others."""

import time
from pathlib import Path

import pytest

from robbie_mp.run import shared_time
from robbie_mp.run.shared_time import FORMAT, LEAD_NS, SharedTime

STEP_NS = 50_000_000


def two(folder: Path) -> tuple[SharedTime, SharedTime]:
    return SharedTime(folder / "time", "red", 2), SharedTime(folder / "time", "blue", 2)


def test_link_that_others_have_planted_in_the_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("a file of this user")
    (tmp_path / "red.time").symlink_to("victim")
    with pytest.raises(OSError, match=r"red\.time"):
        SharedTime(tmp_path, "red").may_go_to(STEP_NS)
    assert (tmp_path / "victim").read_text() == "a file of this user"


def test_no_time_passes_until_all_runs_are_there(tmp_path: Path) -> None:
    red, blue = two(tmp_path)
    assert not red.may_go_to(STEP_NS)
    assert not red.has_begun
    assert blue.may_go_to(STEP_NS)
    assert red.may_go_to(STEP_NS)
    assert red.has_begun


def test_a_run_waits_for_those_that_are_behind_it(tmp_path: Path) -> None:
    red, blue = two(tmp_path)
    red.may_go_to(0)
    blue.may_go_to(0)
    assert red.may_go_to(LEAD_NS)
    assert not red.may_go_to(LEAD_NS + 1)
    assert not blue.may_go_to(STEP_NS)
    # Now each knows where the other wants to go, so the one that is behind may go.
    assert red.may_go_to(LEAD_NS + 1)
    assert red.may_go_to(STEP_NS)
    assert blue.may_go_to(STEP_NS)


def test_runs_of_different_steps_stay_together_and_none_waits_for_ever(tmp_path: Path) -> None:
    runs = {name: SharedTime(tmp_path, name, 3) for name in ("red", "blue", "green")}
    steps_ns = {"red": 7_000_000, "blue": 50_000_000, "green": 20_000_000}
    times_ns = dict.fromkeys(runs, 0)
    for run in runs.values():
        run.may_go_to(0)
    for _ in range(300):
        went = [name for name in runs if runs[name].may_go_to(times_ns[name] + steps_ns[name])]
        assert went
        for name in went:
            times_ns[name] += steps_ns[name]
        assert max(times_ns.values()) - min(times_ns.values()) <= LEAD_NS + 50_000_000
    assert min(times_ns.values()) > 1_000_000_000


def test_runs_that_leave_or_die_are_not_waited_for(tmp_path: Path) -> None:
    red, blue = two(tmp_path)
    red.may_go_to(0)
    blue.may_go_to(0)
    assert not red.may_go_to(STEP_NS)
    red.stale_s = -shared_time.AHEAD_S
    assert red.may_go_to(STEP_NS)
    red.stale_s = shared_time.STALE_S
    look(red)
    assert not red.may_go_to(2 * STEP_NS)
    blue.leave()
    assert red.may_go_to(2 * STEP_NS)


def look(run: SharedTime) -> None:
    """Have it look at once which runs are there."""
    run._look_s = -float("inf")


def two_that_know_each_other(folder: Path) -> tuple[SharedTime, SharedTime]:
    red, blue = two(folder)
    red.may_go_to(0)
    blue.may_go_to(0)
    look(red)
    red.may_go_to(0)
    return red, blue


def test_a_run_that_died_is_counted_and_named_until_it_is_back(tmp_path: Path) -> None:
    red, blue = two_that_know_each_other(tmp_path)
    assert (red.missing, red.given_up) == (set(), 0)
    red.stale_s = -shared_time.AHEAD_S
    look(red)
    assert red.may_go_to(STEP_NS)
    assert (red.missing, red.given_up) == ({"blue"}, 1)
    red.stale_s = shared_time.STALE_S
    look(red)
    assert not red.may_go_to(2 * STEP_NS)
    assert (red.missing, red.given_up) == (set(), 1)
    blue.leave()
    look(red)
    assert red.may_go_to(2 * STEP_NS)
    assert (red.missing, red.given_up) == (set(), 1)


def test_a_run_that_goes_on_without_a_dead_one_knows_it_before_its_next_regular_look(tmp_path: Path) -> None:
    red, _ = two_that_know_each_other(tmp_path)
    red._look_s = float("inf")
    red.stale_s = -shared_time.AHEAD_S
    assert red.may_go_to(STEP_NS)
    assert (red.missing, red.given_up) == ({"blue"}, 1)


def test_runs_that_died_long_ago_are_not_among_those_that_must_be_there(tmp_path: Path) -> None:
    now_s = time.monotonic()
    for run, told_s in {"old": now_s - 100.0, "before_the_start_of_the_machine": now_s + 1e6}.items():
        (tmp_path / f"{run}.time").write_bytes(FORMAT.pack(1, 0, told_s, 1))
    red, blue = SharedTime(tmp_path, "red", 2), SharedTime(tmp_path, "blue", 2)
    assert not red.may_go_to(STEP_NS)
    assert blue.may_go_to(STEP_NS)
    assert red.may_go_to(STEP_NS)


@pytest.mark.parametrize("content", [b"damaged", FORMAT.pack(1, 0, 0.0, 2)])
def test_a_damaged_file_holds_nobody_up(tmp_path: Path, content: bytes) -> None:
    red = SharedTime(tmp_path, "red")
    (tmp_path / "blue.time").write_bytes(content)
    assert red.may_go_to(STEP_NS)
