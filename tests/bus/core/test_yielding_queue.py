"""A queue that yields: of each channel, only the newest message of a publisher that paces itself waits."""

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from tests.bus.core._support.simulated_run import CREDIT, SimulatedModule, SimulatedRun

ALWAYS = MessageHandling.ALWAYS_DELIVER
PACED, SINK, BOX, OTHER = 1, 2, 3, 4


class Robot:
    """A paced publisher and another one, a sink that handles all, and a box whose queue yields."""

    def __init__(self, queue_bytes: int = 1 << 20, box_wants: MessageHandling = ALWAYS) -> None:
        self.run = SimulatedRun(slots=6, yielding=BOX, queue_bytes=queue_bytes)
        self.paced, self.other = self.run.start(PACED), self.run.start(OTHER)
        self.points = self.paced.advertise()
        self.map = self.paced.advertise("map", "test_msgs/msg/Map", is_latched=True)
        self.orders = self.other.advertise("orders", "test_msgs/msg/Order")
        for publisher in (self.paced, self.other):
            publisher.ready()
        self.sink, self.box = self.run.start(SINK), self.run.start(BOX)
        self.sink.subscribe_by_patterns("*")
        if box_wants is ALWAYS:
            self.box.subscribe_by_patterns("*")
        else:
            self.box.subscribe(box_wants)
        for module in (self.sink, self.box):
            module.ready()
        self.run.run_core()

    def publish(self, publisher: SimulatedModule, channel: int, value: int, size: int = 8) -> None:
        assert publisher.publish(channel, value, size)
        self.run.run_core()
        self.sink.handle_all()
        self.run.run_core()

    def fill_ring(self) -> None:
        for _ in range(CREDIT):
            self.publish(self.paced, self.points, 0)

    def pace(self) -> None:
        self.paced.endpoint.pace()
        self.run.run_core()

    def wait_for(self, blocks: int) -> bool:
        """Wait until this number of further blocks is freed; return whether all were at once."""
        self.paced.collect_freed()
        before = self.paced.wakeups
        self.paced.endpoint.wake_after_freed(blocks)
        self.run.run_core()
        return self.paced.wakeups > before

    def queued(self) -> int:
        """Messages that the box has not been sent yet."""
        return self.run.waiting(BOX) - self.run.in_hands(BOX)

    def dropped(self) -> int:
        return sum(self.run.counts(row)["dropped"] for row in range(8))

    def box_handles(self, expected: list[int]) -> None:
        """Let the box handle all that there is for it."""
        handled: list[int] = []
        while found := self.box.handle_all():
            handled += found
            self.run.run_core()
        assert handled == expected


def test_publisher_waits_only_for_the_ring_and_the_newest() -> None:
    robot = Robot()
    robot.fill_ring()
    assert not robot.wait_for(2), "these are in the ring of the box"
    for value in range(20):
        robot.publish(robot.paced, robot.points, value)
    assert robot.queued() == 1 and robot.dropped() == 19
    robot.box_handles([*[0] * CREDIT, 19])


def test_messages_wait_for_the_box_if_their_publisher_does_not_pace_itself() -> None:
    robot = Robot()
    robot.fill_ring()
    for value in range(20):
        robot.publish(robot.other, robot.orders, value)
    assert robot.queued() == 20 and robot.dropped() == 0
    robot.pace()
    for value in range(20):
        robot.publish(robot.paced, robot.points, value)
    robot.box_handles([*[0] * CREDIT, *range(20), 19])
    assert robot.dropped() == 19


def test_box_that_keeps_up_gets_everything_in_order() -> None:
    robot = Robot()
    robot.pace()
    for _ in range(20):
        for value in range(CREDIT):
            robot.publish(robot.paced, robot.points, value)
        robot.box_handles(list(range(CREDIT)))
    assert robot.dropped() == 0


def test_flood_drops_no_message_of_another_topic() -> None:
    robot = Robot()
    robot.pace()
    robot.fill_ring()
    robot.publish(robot.paced, robot.map, 100)
    for value in range(20):
        robot.publish(robot.paced, robot.points, value)
    assert robot.queued() == 2
    robot.box_handles([*[0] * CREDIT, 100, 19])


def test_message_that_another_module_keeps_blocks_nothing() -> None:
    robot = Robot()
    robot.pace()
    robot.fill_ring()
    assert robot.paced.publish(robot.points, 1)
    robot.run.run_core()
    assert robot.sink.take()
    for value in range(20):
        robot.publish(robot.paced, robot.points, value)
    assert robot.queued() == 1


def test_what_waits_of_a_dead_publisher_is_not_dropped() -> None:
    robot = Robot()
    robot.pace()
    robot.fill_ring()
    robot.publish(robot.paced, robot.points, 1)
    robot.run.kill(robot.paced)
    again = robot.run.start(PACED, incarnation=2)
    points = again.advertise()
    again.ready()
    again.endpoint.pace()
    for value in range(2, 9):
        robot.publish(again, points, value)
    assert robot.queued() == 2
    robot.box_handles([*[0] * CREDIT, 1, 8])


def test_core_that_takes_over_knows_who_paces_itself() -> None:
    robot = Robot()
    robot.pace()
    robot.run.restart_core()
    robot.fill_ring()
    for value in range(8):
        robot.publish(robot.paced, robot.points, value)
    assert robot.queued() == 1 and robot.dropped() == 7


def test_large_message_of_a_flood_drops_nothing_of_others() -> None:
    robot = Robot(queue_bytes=700)
    robot.pace()
    robot.fill_ring()
    for _ in range(20):
        robot.publish(robot.other, robot.orders, 7)
    for value in range(20):
        robot.publish(robot.paced, robot.points, value, size=500)
    assert robot.queued() == 21 and robot.dropped() == 19


def test_newest_is_kept_also_where_only_the_newest_is_wanted() -> None:
    robot = Robot(box_wants=MessageHandling.KEEP_ONLY_NEWEST)
    robot.pace()
    for value in range(5):
        robot.publish(robot.paced, robot.points, value)
    robot.box_handles([0, 4])


def test_telling_that_it_paces_itself_asks_nobody_to_post() -> None:
    robot = Robot()
    robot.paced.endpoint.pace()
    robot.run.run_core()
    robot.run.run_core()
    assert robot.box.into[layout.IN_WANT_RELEASE] == robot.sink.into[layout.IN_WANT_RELEASE] == 0
