"""Race day: drives a course with boundaries and obstacles as fast as possible."""

import itertools
import json
import math

from robbie_mp import Duration, Header, MessageHandling, Time, setting
from robbie_mp.messages import ControlState, DriveCommand, LaserScan, Odometry, PoseStamped
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_robots.hw.pose import Pose
from robbie_robots.modules.maps.planar_messages import planar, sweep_of
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.workers.laser.laser_sweep import UnusableSweeps
from robbie_robots.workers.parcours.lap_counter import LapCounter, LapState
from robbie_robots.workers.parcours.race_driver import RaceDriver, RaceLimits


class Parcours(MovingModule):
    """Drives a closed course by the laser alone, counts laps, and ends after the last one.

    It counts them by the robot's pose on the map (`map_pose`), or by odometry as long as there is none;
    odometry may be wrong by metres after a lap. Laps that were counted survive a restart. Their times are in
    `laps.json` in the run's results.
    """

    period_s: float = setting(0.05, "time between drive commands", minimum=0.01)
    laps: int = setting(2, "laps to drive", minimum=1)
    command_valid_for_s: float = setting(
        0.3,
        "the drive stops when no newer command arrives within this time",
        minimum=0.01,
        maximum=MAX_VALID_FOR_S,
    )
    stale_s: float = setting(0.3, "the robot stops when the newest scan is older than this", minimum=0.05)
    max_linear_m_per_s: float = setting(0.8, "maximum speed", minimum=0.05, changeable=True)
    scan_topic: str = setting("", "topic of the laser to use, if the robot has several; '' for any")
    margin_m: float = setting(0.08, "distance kept from everything", minimum=0.0)

    def setup(self) -> None:
        """Subscribe; the first scan creates the driver."""
        self.driver: RaceDriver | None = None
        self.unusable = UnusableSweeps()
        self.speeds = (0.0, 0.0)
        self.scan_stamp = self.odometry_stamp = Time()
        self.scanned_ns = -math.inf
        self.holds = False
        self.speed_m_per_s = 0.0
        self.counter = LapCounter(self.restored and LapState.from_plain(self.restored["laps"]))
        self.has_map: bool = self.restored is not None and self.restored["has_map"]
        self.began_s: float = self.monotonic_s() if self.restored is None else self.restored["began_s"]
        self.subscribe(
            LaserScan,
            self.on_scan,
            MessageHandling.KEEP_ONLY_NEWEST,
            topic=self.scan_topic,
            deadline_s=self.stale_s,
        )
        self.subscribe(Odometry, self.on_odometry, topic="odom")
        self.subscribe(
            ControlState, self.on_control, MessageHandling.KEEP_ONLY_NEWEST, topic="control", optional=True
        )
        self.subscribe(PoseStamped, self.on_map_pose, topic="map_pose", optional=True)

    def setting_changed(self, _name: str) -> None:
        """Take the new maximum speed with the next scan."""
        self.driver = None

    def on_scan(self, scan: LaserScan) -> None:
        """Choose the speeds. An unusable scan counts as none."""
        sweep = sweep_of(scan)
        if not self.unusable.passes(sweep):
            return
        if self.driver is None:
            limits = RaceLimits(max_linear_m_per_s=self.max_linear_m_per_s, margin_m=self.margin_m)
            self.driver = RaceDriver(limits)
        self.scan_stamp, self.scanned_ns = scan.header.stamp, self.envelope.published_ns
        self.speeds = self.driver.drive(sweep, self.speed_m_per_s)

    def on_control(self, control: ControlState) -> None:
        """Stand while an operator drives, and until somebody orders the robot to go on."""
        self.holds = control.mode != ControlState.AUTO

    def on_odometry(self, odometry: Odometry) -> None:
        """Take the speed; count laps as long as there is no map."""
        self.speed_m_per_s = odometry.twist.twist.linear.x
        self.odometry_stamp = odometry.header.stamp
        if not self.has_map:
            self.count(Pose(*planar(odometry.pose.pose)))

    def on_map_pose(self, pose: PoseStamped) -> None:
        """Count laps. The first pose on the map begins them again, as it is in another frame."""
        if not self.has_map:
            self.has_map = True
            self.counter = LapCounter()
        self.count(Pose(*planar(pose.pose)))

    def count(self, pose: Pose) -> None:
        """Count laps by a pose, and keep them."""
        if self.counter.see(pose, self.monotonic_s()):
            ends_s = [self.began_s, *self.counter.state.ends_s]
            self.log.info("lap %d took %.2f s", self.counter.laps, ends_s[-1] - ends_s[-2])
        kept = {"laps": self.counter.state.plain(), "began_s": self.began_s, "has_map": self.has_map}
        self.checkpoint(kept)

    def act(self) -> None:
        """Command the drive; end after the last lap."""
        if self.counter.laps >= self.laps:
            self._finish()
            return
        # Both: a laser may send old sweeps, and the clock of stamps may be set.
        age_ns = max(
            self.clock.now_ns() - self.scan_stamp.nanoseconds, self.clock.monotonic_ns() - self.scanned_ns
        )
        is_fresh = age_ns <= self.stale_s * 1e9
        self._command(*(self.speeds if is_fresh and not self.holds else (0.0, 0.0)))
        self.show_state("HOLD" if self.holds else "RACE" if is_fresh else "STOPPED_NO_LASER")
        lap = self.counter.laps + 1
        self.status = f"lap {lap} of {self.laps}, {self.speed_m_per_s:.2f} m/s{self.unusable}"

    def _finish(self) -> None:
        self._command(0.0, 0.0)
        ends_s = [self.began_s, *self.counter.state.ends_s]
        times_s = [round(end - begin, 3) for begin, end in itertools.pairwise(ends_s)]
        self.write_result("laps.json", json.dumps({"laps_s": times_s}) + "\n")
        self.status = f"{self.laps} laps, the fastest in {min(times_s):.2f} s"
        self.show_state("FINISHED")
        self.log.info("%s", self.status)
        self.stop()

    def _command(self, linear_m_per_s: float, angular_rad_per_s: float) -> None:
        self.publish(
            DriveCommand(
                header=Header(stamp=self.now(), frame_id="base_link"),
                linear_m_per_s=linear_m_per_s,
                angular_rad_per_s=angular_rad_per_s,
                valid_for=Duration.from_nanoseconds(round(self.command_valid_for_s * 1e9)),
                # How early it brakes before a corner rests on its speed.
                based_on=min(self.scan_stamp, self.odometry_stamp, key=lambda stamp: stamp.nanoseconds),
            )
        )
