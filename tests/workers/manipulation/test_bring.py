"""Orders to bring something: steps, failures, time limits, and the next process."""

from workers.manipulation.bring import ARM_S, BringMission, BringOrder, BringState

ORDER = BringOrder("soup", "table", "counter")


class Clock:
    def __init__(self) -> None:
        self.now_s = 5.0

    def __call__(self) -> float:
        return self.now_s


def begun(clock: Clock) -> BringMission:
    mission = BringMission(clock)
    mission.begin(ORDER)
    return mission


def test_order_is_carried_out_step_by_step() -> None:
    clock = Clock()
    mission = begun(clock)
    assert (mission.place, mission.arm_task) == ("table", None)
    mission.arrived()
    assert (mission.place, mission.arm_task) == (None, BringState.PICK)
    mission.arm_done()
    assert mission.place == "counter"
    mission.arrived()
    clock.now_s += 20.0
    mission.arm_done()
    (end,) = mission.ends
    assert (end.order, end.is_done, end.duration_s) == (ORDER, True, 20.0)
    assert (mission.order, mission.machine.state) == (None, BringState.WAIT)


def test_robot_drives_to_the_table_again_when_the_arm_fails_and_gives_up_at_last() -> None:
    mission = begun(Clock())
    for _ in range(2):
        mission.arrived()
        mission.arm_failed("sees no soup")
        assert mission.machine.state is BringState.FETCH
    mission.arrived()
    mission.arm_failed("sees no soup")
    assert [(end.is_done, end.reason) for end in mission.ends] == [(False, "sees no soup")]


def test_order_ends_when_a_place_is_unreachable_or_a_step_takes_too_long_or_on_demand() -> None:
    clock = Clock()
    mission = begun(clock)
    mission.unreachable("the goal lies in unknown space")
    mission.begin(ORDER)
    mission.arrived()
    clock.now_s += ARM_S - 1.0
    mission.step()
    assert mission.arm_task is BringState.PICK
    clock.now_s += 2.0
    mission.step()
    mission.begin(ORDER)
    mission.cancel("enough")
    reasons = [end.reason for end in mission.ends]
    assert reasons == ["the goal lies in unknown space", "PICK took too long", "enough"]
    assert mission.machine.state is BringState.WAIT


def test_next_process_goes_on_with_the_same_step() -> None:
    clock = Clock()
    mission = begun(clock)
    mission.arrived()
    mission.arm_done()
    clock.now_s += 7.0
    later = BringMission(clock)
    later.remember(mission.memory())
    assert (later.machine.state, later.place, later.order) == (BringState.CARRY, "counter", ORDER)
    later.arrived()
    later.arm_done()
    assert later.ends[-1].duration_s == 7.0
    last = BringMission(clock)
    last.remember(later.memory())
    assert (last.order, list(last.ends)) == (None, list(later.ends))


def test_late_answers_of_the_arm_and_of_navigation_change_nothing() -> None:
    mission = begun(Clock())
    mission.arm_done()
    mission.arm_failed("too late")
    assert mission.place == "table"
    mission.arrived()
    mission.unreachable("too late")
    mission.arrived()
    assert mission.arm_task is BringState.PICK
