"""The modules of the robot of a trial. They write down what they send and receive, with the time."""

from robbie_mp import ActiveGoal, EncodedMessage, Header, MessageHandling, Module, Time
from robbie_mp.messages import (
    DriveCommand,
    LaserScan,
    NavigateTo,
    NavigationFeedback,
    NavigationResult,
    OccupancyGrid,
    PoseStamped,
)
from tools.journal import Journal
from tools.ros1.stock import TYPES_OF_ROS1, topic_of

EACH_S = 0.2


class Speaker(Module):
    """Publishes numbered scans, a map once, and a message of each type that ROS 1 has, again and again.

    Lines of its journal: P NUMBER TIME.
    """

    period_s = 0.02

    def setup(self) -> None:
        """Prepare the numbers."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.number = 0
        self.others_at_s = 0.0

    def tick(self) -> None:
        """Publish."""
        header = Header(stamp=Time(sec=self.number), frame_id="laser")
        if self.number == 0:
            self.publish(OccupancyGrid(header=Header(frame_id="map")), topic="map", latched=True)
        sent = self.publish(LaserScan(header=header), topic="scan")
        self.journal.note("P" if sent else "R", self.number)
        self.number += 1
        now_s = self.clock.monotonic_ns() / 1e9
        if now_s - self.others_at_s > EACH_S:
            self.others_at_s = now_s
            for one in TYPES_OF_ROS1:
                self.publish(one(), topic=topic_of(one))


class Listener(Module):
    """Hears every scan inside the robot. Lines of its journal: G NUMBER TIME."""

    def setup(self) -> None:
        """Subscribe."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.subscribe(LaserScan, self.on_scan, topic="scan")

    def on_scan(self, scan: LaserScan) -> None:
        """Note its number."""
        self.journal.note("G", scan.header.stamp.sec)


class Base(Module):
    """Takes what ROS sends to a robot.

    Lines of its journal: drive, goal, pose or status, a number, and the time.
    """

    def setup(self) -> None:
        """Subscribe, and serve goals."""
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.subscribe(DriveCommand, self.on_command, MessageHandling.ALWAYS_DELIVER, topic="manual")
        self.subscribe(PoseStamped, self.on_pose, topic="initial_pose")
        self.subscribe_encoded("actionlib_msgs/*", self.on_status, topic="status")
        self.serve_goals(NavigateTo, self.on_goal)

    def on_command(self, command: DriveCommand) -> None:
        """Note how long it is valid."""
        self.journal.note("drive", command.linear_m_per_s, command.valid_for.seconds)

    def on_pose(self, pose: PoseStamped) -> None:
        """Note where it is."""
        self.journal.note("pose", pose.pose.position.x)

    def on_status(self, message: EncodedMessage) -> None:
        """Note the size of a message of a type that only ROS knows."""
        self.journal.note("status", len(message.data))

    def on_goal(self, active: ActiveGoal[NavigateTo, NavigationFeedback, NavigationResult]) -> None:
        """Note where it is, and be there."""
        self.journal.note("goal", active.goal.pose.pose.position.x)
        active.succeed(NavigationResult())
