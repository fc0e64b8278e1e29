"""A queue that yields: nothing waits in it whose publisher paces itself."""

from robbie_mp import MessageHandling
from tests.bus.core._support.simulated_run import CREDIT, SimulatedModule, SimulatedRun

ALWAYS = MessageHandling.ALWAYS_DELIVER
PACED, SINK, BOX, OTHER = 1, 2, 3, 4


class Robot:
    """A paced publisher and another one, a sink that handles all, and a box that stands still."""

    def __init__(self) -> None:
        self.run = SimulatedRun(slots=6, yielding=BOX)
        self.paced, self.other = self.run.start(PACED), self.run.start(OTHER)
        self.points = self.paced.advertise()
        self.map = self.paced.advertise("map", "test_msgs/msg/Map", is_latched=True)
        self.orders = self.other.advertise("orders", "test_msgs/msg/Order")
        for publisher in (self.paced, self.other):
            publisher.ready()
        self.sink, self.box = self.run.start(SINK), self.run.start(BOX)
        for module in (self.sink, self.box):
            module.subscribe_by_patterns("*")
            module.ready()
        self.run.run_core()

    def publish(self, publisher: SimulatedModule, channel: int, count: int = 1) -> None:
        for value in range(count):
            assert publisher.publish(channel, value)
            self.run.run_core()
            self.sink.handle_all()
            self.run.run_core()

    def wait_for(self, blocks: int) -> bool:
        """Wait until this number of further blocks is freed; return whether all were at once."""
        self.paced.collect_freed()
        before = self.paced.wakeups
        self.paced.endpoint.wake_after_freed(blocks)
        self.run.run_core()
        return self.paced.wakeups > before

    def queued(self, slot: int) -> int:
        """Messages that a module has not been sent yet."""
        return self.run.waiting(slot) - self.run.in_hands(slot)

    def dropped(self) -> int:
        return sum(self.run.counts(row)["dropped"] for row in range(8))


def test_publisher_waits_only_for_what_is_in_the_ring() -> None:
    robot = Robot()
    robot.publish(robot.paced, robot.points, CREDIT)
    assert not robot.wait_for(2), "these are in the ring of the box"
    robot.publish(robot.paced, robot.points, 20)
    assert robot.queued(BOX) == 0 and robot.dropped() == 20
    assert robot.wait_for(0)


def test_messages_wait_for_the_box_if_their_publisher_does_not_pace_itself() -> None:
    robot = Robot()
    robot.publish(robot.paced, robot.points, 20)
    assert robot.queued(BOX) == 20 - CREDIT and robot.dropped() == 0
    robot.wait_for(30)
    robot.publish(robot.paced, robot.points)
    robot.publish(robot.other, robot.orders, 3)
    assert robot.queued(BOX) == 20 - CREDIT + 3 and robot.dropped() == 1


def test_box_that_keeps_up_gets_everything_in_order() -> None:
    robot = Robot()
    robot.wait_for(2)
    for _ in range(20):
        robot.publish(robot.paced, robot.points, CREDIT)
        assert robot.box.handle_all() == list(range(CREDIT))
        robot.run.run_core()
    assert robot.dropped() == 0


def test_latched_messages_and_those_of_others_wait_in_their_order() -> None:
    robot = Robot()
    robot.wait_for(2)
    robot.publish(robot.paced, robot.points, CREDIT)
    robot.publish(robot.other, robot.orders)
    robot.publish(robot.paced, robot.map)
    robot.publish(robot.paced, robot.points, 20)
    assert robot.queued(BOX) == 2 and robot.dropped() == 20
    assert robot.box.handle_all() == list(range(CREDIT))
    robot.run.run_core()
    assert robot.box.handle_all() == [0, 0]


def test_message_that_another_module_keeps_blocks_nothing() -> None:
    robot = Robot()
    robot.wait_for(2)
    robot.publish(robot.paced, robot.points, CREDIT)
    assert robot.paced.publish(robot.points, 1)
    robot.run.run_core()
    assert robot.sink.take()
    robot.publish(robot.paced, robot.points, 20)
    assert robot.queued(BOX) == 0


def test_what_waits_of_a_dead_publisher_is_not_dropped() -> None:
    robot = Robot()
    robot.publish(robot.paced, robot.points, CREDIT + 8)
    robot.paced.endpoint.wake_after_freed(5)
    robot.run.kill(robot.paced)
    assert robot.queued(BOX) == 8 and robot.dropped() == 0


def test_core_that_takes_over_knows_who_paces_itself() -> None:
    robot = Robot()
    robot.wait_for(2)
    robot.run.restart_core()
    robot.publish(robot.paced, robot.points, CREDIT + 8)
    assert robot.queued(BOX) == 0 and robot.dropped() == 8


def test_two_queues_that_yield_hold_nothing_up() -> None:
    robot = Robot()
    second = robot.run.start(5)
    robot.run.limits[5] = robot.run.limits[BOX]
    robot.run.restart_core()
    second.subscribe_by_patterns("*")
    second.ready()
    robot.run.run_core()
    robot.wait_for(2)
    robot.publish(robot.paced, robot.points, CREDIT + 8)
    assert robot.queued(BOX) == robot.queued(5) == 0 and robot.dropped() == 16
