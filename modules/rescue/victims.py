"""Finds victims in the camera's images, places them on the map, and asks the operator about them."""

import math
from typing import Any

import numpy as np

from robbie_mp import CallRefused, Header, MessageHandling, Module, SettingError, Time, setting
from robbie_mp.messages import (
    BoundingBox2D,
    CameraInfo,
    Detection2D,
    Detection2DArray,
    Image,
    MapMetaData,
    Mark,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    OccupancyGrid,
    Point,
    Point2D,
    Pose,
    Pose2D,
    Quaternion,
)
from robbie_mp.scene import RigidTransform, SceneGraphError, SceneGraphListener, TooNew
from robbie_robots.modules.maps.planar_messages import map_cells
from robbie_robots.modules.rescue.messages import AnswerVictim, SearchedWalls, VictimAnswered, VictimFound
from robbie_robots.modules.sensor_deadlines import CAMERA_S
from robbie_robots.workers.rescue.searched_walls import CameraView, WallFronts, WallMemory
from robbie_robots.workers.rescue.victim_detection import (
    Projection,
    TagSighting,
    VictimDetector,
    VisionMissing,
)
from robbie_robots.workers.rescue.victim_map import Victim, VictimMap, VictimState

ASK_AGAIN_S = 60.0
"""Time before the same question is asked again."""

REPEAT_S = 5.0
"""Each victim is published again after this time."""

SEARCHED_PERIOD_S = 0.5
"""Time between messages about searched walls."""

TURNED_S, TURNED_RAD = 0.1, 0.02
"""An image is not used if the camera has turned by more than this angle in this time before it."""


class Victims(Module):
    """Searches for victims, publishes each as `VictimFound`, and asks the operator about those it knows well.

    The module publishes the tags in an image as `Detection2DArray` on the image's topic. The operator answers
    with the service `AnswerVictim`. Without an answer in time, the module asks again later. It also publishes
    `SearchedWalls`, the walls that the camera has seen well, and a `Mark` when it knows a victim well for the
    first time, so that the black box keeps that moment.

    After a restart, it still knows all victims, answers and searched walls.
    """

    tag_edge_m: float = setting(0.25, "edge of a victim's tag, including its black border", minimum=0.01)
    confirms_by_itself: bool = setting(
        False, "confirm victims that are known well without asking the operator"
    )
    answer_s: float = setting(20.0, "time that the operator has for an answer", minimum=0.1)
    max_questions: int = setting(2, "maximum number of questions about one victim", minimum=1)
    near_m: float = setting(1.8, "a victim must have been seen from at most this distance", minimum=0.1)
    far_m: float = setting(2.4, "maximum distance at which a wall counts as searched", minimum=0.5)
    map_topic: str = setting("", "topic of the map to use, if the robot has several; '' for any")
    camera_frame: str = setting("base_link", "frame that the pan-tilt unit is mounted on")
    period_s: float = setting(0.1, "time between searches of new images", minimum=0.01)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check that OpenCV is installed before anything starts."""
        try:
            VictimDetector()
        except VisionMissing as error:
            raise SettingError(str(error)) from error

    def setup(self) -> None:
        """Create the workers; subscribe to camera and operator."""
        self.detector = VictimDetector(self.tag_edge_m)
        self.victims = VictimMap(near_m=self.near_m)
        self.searched = WallMemory(CameraView(far_m=self.far_m))
        self.projection: Projection | None = None
        self.half_width_rad = 0.0
        self.fronts: WallFronts | None = None
        self.map_info: MapMetaData | None = None
        self.image: Image | None = None
        self.images = 0
        self.next_s = {"searched": 0.0, "repeat": 0.0}
        if self.restored is not None:
            self.victims.restore(self.restored["victims"])
            self.searched.restore(self.restored["searched"])
            self.images = self.restored["images"]
        self.scene = SceneGraphListener(self)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(CameraInfo, self.on_camera, newest, topic="camera")
        self.subscribe(Image, self.on_image, newest, topic="camera", deadline_s=CAMERA_S)
        self.subscribe(OccupancyGrid, self.on_map, newest, topic=self.map_topic)
        self.advertise(VictimFound)
        self.serve(AnswerVictim, self.on_answer)

    def on_camera(self, camera: CameraInfo) -> None:
        """Store the camera's projection."""
        if not camera.is_calibrated:
            self.status = "the camera is not calibrated"
            return
        k = camera.k
        self.projection = Projection((float(k[0]), float(k[4])), (float(k[2]), float(k[5])))
        self.half_width_rad = math.atan(camera.width / 2 / float(k[0]))

    def on_image(self, image: Image) -> None:
        """Keep the newest image until the camera's pose at its stamp is known."""
        self.image = image

    def on_map(self, grid: OccupancyGrid) -> None:
        """Store the walls of a new map."""
        self.fronts = WallFronts(*map_cells(grid))
        self.map_info = grid.info

    def on_answer(self, answer: AnswerVictim) -> VictimAnswered:
        """Apply the operator's answer."""
        victim = self.victims.victims.get(answer.id)
        if victim is None:
            raise CallRefused(f"there is no victim {answer.id}")
        if answer.answer == AnswerVictim.LATER:
            self._ask_later(victim)
        elif answer.answer in (AnswerVictim.YES, AnswerVictim.NO):
            yes = answer.answer == AnswerVictim.YES
            victim.state = VictimState.CONFIRMED if yes else VictimState.REJECTED
        else:
            raise CallRefused(f"there is no answer {answer.answer}; answers are 0 (no), 1 (yes), 2 (later)")
        self._tell(victim)
        return VictimAnswered(state=int(victim.state))

    def tick(self) -> None:
        """Search the newest image, ask questions, and publish changes."""
        if self.image is not None and self.projection is not None:
            self._look()
        now_s = self.monotonic_s()
        for victim in self.victims.victims.values():
            self._ask(victim, now_s)
        if now_s >= self.next_s["repeat"]:
            self.next_s["repeat"] = now_s + REPEAT_S
            for victim in self.victims.victims.values():
                self._tell(victim)
        if now_s >= self.next_s["searched"] and self.fronts is not None:
            self.next_s["searched"] = now_s + SEARCHED_PERIOD_S
            self._tell_searched()
        states = [victim.state for victim in self.victims.victims.values()]
        self.status = (
            f"{len(states)} victims, {states.count(VictimState.CONFIRMED)} confirmed; {self.images} images"
        )

    def _look(self) -> None:
        """Search the newest image for victims, as soon as the camera's pose is known."""
        assert self.image is not None
        assert self.projection is not None
        image, stamp_ns = self.image, self.image.header.stamp.nanoseconds
        try:
            X_MC = self.scene.pose("map", image.header.frame_id, stamp_ns)
            turning = self._is_turning(image.header.frame_id, stamp_ns)
        except TooNew:
            return  # the transforms have not arrived yet
        except SceneGraphError as error:
            self.log.debug("could not use an image: %s", error)
            self.image = None
            return
        self.image = None
        if turning:
            return
        self.images += 1
        pixels = image.data.reshape(image.height, image.step)[:, : 3 * image.width]
        pixels = np.ascontiguousarray(pixels).reshape(image.height, image.width, 3)
        sightings = self.detector.detect(pixels, self.projection)
        self.publish(
            Detection2DArray(
                header=image.header, detections=[detection(image.header, one) for one in sightings]
            ),
            topic="camera",
        )
        for sighting in sightings:
            facing = X_MC.apply(sighting.normal) - X_MC.translation
            victim = self.victims.see(
                sighting.tag,
                X_MC.apply(sighting.position_m),
                math.atan2(facing[1], facing[0]),
                float(np.linalg.norm(sighting.position_m)),
                stamp_ns / 1e9,
                sighting.patch,
            )
            self._tell(victim)
        if self.fronts is not None:
            self.searched.look(self.fronts, optical_axis(X_MC), self.half_width_rad)

    def _is_turning(self, frame: str, stamp_ns: int) -> bool:
        """Return whether the camera turns on the robot, so that its direction is not known well."""
        before = self.scene.pose(self.camera_frame, frame, stamp_ns - round(TURNED_S * 1e9))
        now = self.scene.pose(self.camera_frame, frame, stamp_ns)
        return abs(math.remainder(optical_axis(now)[2] - optical_axis(before)[2], math.tau)) > TURNED_RAD

    def _ask(self, victim: Victim, now_s: float) -> None:
        """Ask the operator, or stop waiting for an answer."""
        if victim.state is VictimState.ASKED and now_s - victim.asked_s >= self.answer_s:
            self.log.info("no answer for victim %d", victim.tag)
            self._ask_later(victim)
            self._tell(victim)
        elif (
            victim.state is VictimState.SUSPECTED
            and self.victims.is_known_well(victim)
            and now_s >= victim.not_before_s
            and victim.questions < self.max_questions
        ):
            victim.state = VictimState.CONFIRMED if self.confirms_by_itself else VictimState.ASKED
            victim.asked_s = now_s
            victim.questions += 1
            self.log.info("victim %d at %s: %s", victim.tag, victim.position_m.round(2), victim.state.name)
            if victim.questions == 1:
                x_m, y_m, _ = victim.position_m.tolist()
                found = f"victim found: tag {victim.tag} at {x_m:.1f}, {y_m:.1f} m"
                self.publish(Mark(header=Header(stamp=self.now(), frame_id="map"), text=found))
            self._tell(victim)

    def _ask_later(self, victim: Victim) -> None:
        victim.state = VictimState.SUSPECTED
        victim.not_before_s = self.monotonic_s() + ASK_AGAIN_S

    def _tell(self, victim: Victim) -> None:
        """Publish and checkpoint what is known about a victim."""
        x_m, y_m, z_m = victim.position_m.tolist()
        rows, columns, _ = victim.patch.shape
        header = Header(stamp=Time.from_nanoseconds(round(victim.last_s * 1e9)), frame_id="map")
        self.publish(
            VictimFound(
                header=header,
                id=victim.tag,
                name=f"tag {victim.tag}",
                pose=Pose(
                    position=Point(x=x_m, y=y_m, z=z_m), orientation=Quaternion.from_yaw(victim.facing_rad)
                ),
                spread_m=victim.spread_m,
                confidence=victim.confidence,
                views=victim.views,
                state=int(victim.state),
                answer_within_s=self._answer_within_s(victim),
                image=Image(
                    header=header,
                    height=rows,
                    width=columns,
                    encoding="rgb8",
                    step=3 * columns,
                    data=victim.patch.ravel(),
                ),
            )
        )
        self._remember()

    def _answer_within_s(self, victim: Victim) -> float:
        if victim.state is not VictimState.ASKED:
            return 0.0
        return max(0.0, victim.asked_s + self.answer_s - self.monotonic_s())

    def _tell_searched(self) -> None:
        assert self.fronts is not None
        assert self.map_info is not None
        cells = self.searched.grid(self.fronts)
        header = Header(stamp=self.now(), frame_id="map")
        self.publish(SearchedWalls(header=header, info=self.map_info, data=cells.ravel()))
        self._remember()

    def _remember(self) -> None:
        state: dict[str, Any] = {
            "victims": self.victims.state(),
            "searched": self.searched.state(),
            "images": self.images,
        }
        self.checkpoint(state)


def detection(header: Header, sighting: TagSighting) -> Detection2D:
    """Return the place of a tag in its image."""
    low, high = sighting.corners_px.min(axis=0), sighting.corners_px.max(axis=0)
    x, y = ((low + high) / 2).tolist()
    size_x, size_y = (high - low).tolist()
    name = f"tag {sighting.tag}"
    return Detection2D(
        header=header,
        results=[ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=1.0))],
        bbox=BoundingBox2D(center=Pose2D(position=Point2D(x=x, y=y)), size_x=size_x, size_y=size_y),
        id=str(sighting.tag),
    )


def optical_axis(X_AC: RigidTransform) -> tuple[float, float, float]:
    """Return x, y (m) of a camera and the heading (rad) of its optical axis, in the frame A."""
    ahead = X_AC.apply((0.0, 0.0, 1.0)) - X_AC.translation
    return X_AC.x, X_AC.y, math.atan2(ahead[1], ahead[0])
