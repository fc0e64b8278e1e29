"""Copied into the workspace of tests: a robot that stands still and whose values are all known."""

import numpy as np

from robbie_mp import ActiveGoal, CallRefused, Header, Message, Module, Time, float64
from robbie_mp.messages import (
    AnnotateMap,
    BoundingBox2D,
    CancelNavigation,
    CompressedImage,
    Costmap,
    CostmapMetaData,
    Detection2D,
    Detection2DArray,
    Frontiers,
    Image,
    MapAnnotated,
    MapAnnotations,
    MapMetaData,
    Mark,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    OccupancyGrid,
    Path,
    PlaybackControl,
    PlaybackState,
    Point,
    Point2D,
    PointOfInterest,
    PointsOfInterest,
    Pose,
    Pose2D,
    PoseStamped,
    Quaternion,
    String,
)
from robbie_mp.messages.stock.nav2_msgs import Cost

FRONTIERS = [Point(x=3.5, y=3.0), Point(x=0.5, y=4.5)]


Active = ActiveGoal[NavigateTo, NavigationFeedback, NavigationResult]


class Wish(Message, name="zoo/msg/Wish", version=1):
    """What the test composes: a type that only this robot knows."""

    text: str = ""
    place: Point = Point()
    weight_kg: float64 = 0.0


def pose(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Pose:
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad))


def grid() -> OccupancyGrid:
    """6 m x 4 m with its corner at (-1 m, 2 m): free, but for a wall at the left, and unknown at the top."""
    cells = np.zeros((8, 12), np.int8)
    cells[:, 0] = 100
    cells[-1] = -1
    info = MapMetaData(resolution=0.5, width=12, height=8, origin=pose(-1.0, 2.0))
    return OccupancyGrid(info=info, data=cells.ravel())


def costmap() -> Costmap:
    """An obstacle in the lower right corner of the map, and a place beside it that is too near to it."""
    costs = np.zeros((8, 12), np.uint8)
    costs[0, -1], costs[0, -2] = Cost.OBSTACLE, Cost.TOO_NEAR
    metadata = CostmapMetaData(resolution=0.5, size_x=12, size_y=8, origin=pose(-1.0, 2.0))
    return Costmap(metadata=metadata, data=costs.ravel())


def patch() -> Image:
    """2 x 1 pixels, red and blue, in rows of 8 bytes."""
    data = np.array([0, 0, 255, 255, 0, 0, 9, 9], np.uint8)
    return Image(height=1, width=2, encoding="bgr8", step=8, data=data)


def depths() -> Image:
    """4 x 2 pixels of depth, mm: near at the left, nothing measured at the right."""
    data = np.array([[500, 1000, 2000, 0]] * 2, "<u2").view(np.uint8)
    return Image(height=2, width=4, encoding="16UC1", step=8, data=data.ravel())


def found() -> Detection2DArray:
    """The right pixel of the patch is a fox; all else that it may be is less likely."""
    likely = [
        ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=score))
        for name, score in (("dog", 0.2), ("fox", 0.7))
    ]
    box = BoundingBox2D(center=Pose2D(position=Point2D(x=1.5, y=0.5)), size_x=1.0, size_y=0.5)
    return Detection2DArray(detections=[Detection2D(results=likely, bbox=box)])


class Fragile(Module):
    """Crashes on request."""

    def setup(self) -> None:
        self.subscribe(Wish, self.on_wish, topic="wishes")

    def on_wish(self, wish: Wish) -> None:
        if wish.text == "break":
            raise RuntimeError("it is broken")


class KnownRobot(Module):
    """Publishes all of this repeatedly, and records the messages it receives."""

    period_s = 0.1

    def setup(self) -> None:
        self.file = (self.output_directory / "told.txt").open("a")
        self.position_s, self.paused, self.rate, self.request = 3.0, False, 1.0, 0
        self.active: Active | None = None
        self.serve_goals(NavigateTo, self.on_goal)
        self.serve(CancelNavigation, self.on_cancel)
        self.serve(AnnotateMap, self.on_annotate)
        self.drawn = MapAnnotations()
        self.publish(self.drawn, latched=True)
        self.subscribe(PlaybackControl, self.on_control)
        self.subscribe(Wish, self.on_wish, topic="wishes")
        self.subscribe(PoseStamped, self.on_pose, topic="initial_pose")
        self.subscribe(String, lambda said: self.write("said", said.data), topic="speech_command")
        self.subscribe(Mark, lambda mark: self.write("mark", mark.text))
        self.show_state("LOOK_AROUND")
        self.status = "all is set"
        self.log.warning("the curtain rises")
        self.log.debug("which nobody is told of")

    def tick(self) -> None:
        header = Header(frame_id="map")
        self.publish(grid())
        self.publish(costmap(), topic="costmap")
        self.publish(PoseStamped(header=header, pose=pose(1.5, 3.25, np.pi / 2)), topic="map_pose")
        way = [PoseStamped(header=header, pose=pose(x / 10, 3.0)) for x in range(1201)]
        self.publish(Path(header=header, poses=way), topic="path")
        self.publish(patch(), topic="eye")
        self.publish(found(), topic="eye")
        self.publish(depths(), topic="range")
        home = PointOfInterest(name="home", pose=pose(0.5, 2.5))
        self.publish(PointsOfInterest(header=header, points=[home]))
        self.publish(CompressedImage(format="mystery", data=np.zeros(9, np.uint8)), topic="eye")
        self.publish(Frontiers(header=header, middles=FRONTIERS, lengths_m=np.array([1.0, 0.5], np.float32)))
        self.tell_playback()

    def tell_playback(self) -> None:
        second = 1_000_000_000
        self.publish(
            PlaybackState(
                file="old.mcap",
                begin=Time.from_nanoseconds(100 * second),
                end=Time.from_nanoseconds(110 * second),
                position=Time.from_nanoseconds(round((100 + self.position_s) * second)),
                rate=self.rate,
                paused=self.paused,
                request=self.request,
            )
        )

    def on_annotate(self, request: AnnotateMap) -> MapAnnotated:
        removed = {
            *request.remove,
            *(one.name for one in request.no_go),
            *(one.name for one in request.places),
        }
        self.drawn = MapAnnotations(
            no_go=[*(one for one in self.drawn.no_go if one.name not in removed), *request.no_go],
            places=[*(one for one in self.drawn.places if one.name not in removed), *request.places],
        )
        self.publish(self.drawn, latched=True)
        for area in request.no_go:
            self.write("area", area.name, *(f"{one.x:.2f} {one.y:.2f}" for one in area.corners))
        return MapAnnotated()

    def on_goal(self, active: Active) -> None:
        if active.goal.place:
            self.write("place", active.goal.place)
            raise CallRefused("it is only a test")
        self.write_pose("goal", active.goal.pose)
        if self.active is not None and self.active.is_active:
            raise CallRefused("one goal is enough")
        self.active = active
        self.publish(active.goal.pose, topic="goal")

    def on_cancel(self, request: CancelNavigation) -> NavigationCancelled:
        self.write("cancel")
        if self.active is None or not self.active.is_active:
            return NavigationCancelled()
        self.active.cancelled(request.reason)
        self.publish(PoseStamped(), topic="goal")  # there is none any more
        return NavigationCancelled(client=self.active.client)

    def on_pose(self, placed: PoseStamped) -> None:
        self.write_pose("pose", placed)

    def write_pose(self, what: str, placed: PoseStamped) -> None:
        place = placed.pose.position
        self.write(what, placed.header.frame_id, place.x, place.y, placed.pose.orientation.yaw)

    def on_control(self, control: PlaybackControl) -> None:
        self.request = control.request
        if control.command in ("pause", "resume"):
            self.paused = control.command == "pause"
        elif control.command == "seek":
            self.position_s = control.value
        elif control.command == "rate":
            self.rate = control.value
        self.write("control", control.command, control.value)

    def on_wish(self, wish: Wish) -> None:
        self.write("wish", wish.text, wish.place.x, wish.weight_kg)

    def write(self, *words: object) -> None:
        print(*words, file=self.file, flush=True)

    def teardown(self) -> None:
        self.file.close()
