"""Where the floor is in the pictures of the robot's cameras, and which place on it an operator presses."""

from __future__ import annotations

import math
from collections import deque
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import CameraInfo, CompressedImage, Image, MappingState, PoseStamped
from robbie_mp.scene import RigidTransform, SceneGraphError, TooNew, TooOld
from robbie_mp.station.floor.camera_model import CameraModel, NoFloor, rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sized

    from robbie_mp.module.clock import Clock
    from robbie_mp.scene import SceneGraph
    from robbie_mp.station.watch.births import Births
    from robbie_mp.station.watch.latest import MessageSource

BASE, MAP, ODOM = "base_link", "map", "odom"
NS = 1_000_000_000
LATE_NS = 150_000_000
"""A newest pose that is older than a picture by up to this time still draws lines in it."""
MAX_AGE_S, MAX_POSE_AGE_S = 2.0, 1.0
"""Of a picture that is pressed, as the page greys older ones; and of the robot's pose on the map."""
AHEAD_S = 0.1
TURNS_NS, TURNS_RAD = 50_000_000, 0.03
"""A camera that turns by more than this within that time before or after a picture is not measured by."""
MAX_REACH_M = 10.0
TILT_RAD, MAX_SHIFT_M = math.radians(0.5), 0.5
"""A place counts as near enough if a camera that is tilted by so much more would see it shifted by less."""
LEAST_HEIGHT_M = 0.02
MAX_SLOPE_RAD = 0.1
MAX_CAMERAS = 24
MAX_WAITING = 16


class Touch(NamedTuple):
    """A place in a picture."""

    camera: str
    stamp_ns: int
    """When the picture was taken."""
    across: float
    """Shares of the picture's width and height, from the top left."""
    down: float


class Spot(NamedTuple):
    """A place on the floor that a camera has seen."""

    x_m: float
    """Position in the map frame, as the map was when it was pressed; so is `y_m`."""
    y_m: float
    anchor: tuple[float, float, float]
    """The same place in the frame of odometry, m, in which it stays if the map is corrected."""
    eye: tuple[float, float]
    """Where the camera was, m, map frame."""
    distance_m: float
    """From the camera, along the floor."""


class Taken(NamedTuple):
    """The newest picture of a camera."""

    stamp_ns: int
    frame: str
    size_px: tuple[int, int] | None
    """Its width and height; None: it is compressed."""


class PictureFloor(NamedTuple):
    """Where the floor is in one picture, for pages."""

    stamp_ns: int
    view: dict[str, object] | None
    why: str
    """Why there is no `view`; '' if there is one."""


class FloorSight:
    """Finds the floor in pictures. The module's thread calls everything but `about`, `locate` and `place_of`.

    The floor is the plane on which `base_link` stands.

    Args:
        messages: source of calibrations, of the robot's pose and of how sure mapping is of it.
        graph: where the cameras are.
        births: tells how old the pose is.
        clock: the clock of the pictures' stamps.
        pages: the open pages; without any, it does not look.
        map_topic: topic of the map to show, if there are several.
    """

    def __init__(
        self,
        messages: MessageSource,
        graph: SceneGraph,
        births: Births,
        clock: Clock,
        pages: Sized,
        map_topic: str = "",
    ) -> None:
        self._messages, self._graph, self._births = messages, graph, births
        self._clock, self._pages = clock, pages
        self._models: dict[str, tuple[tuple[object, ...], CameraModel | str]] = {}
        """For each camera: its last calibration, and the model, or why there is none."""
        self._taken: dict[str, Taken] = {}
        self._again: set[str] = set()
        """The cameras whose pose was not exactly known yet when they were looked at."""
        self._floors: dict[str, PictureFloor] = {}
        self._waiting: deque[tuple[Touch, Future[Spot]]] = deque()
        self._pose = messages.newest(PoseStamped, "map_pose")
        self._mapping = messages.newest(MappingState, map_topic)
        self._X_MA: RigidTransform | None = None
        messages.hear(CameraInfo, self._on_info)  # each: a module may have several cameras

    def _on_info(self, info: CameraInfo) -> None:
        topic, told = self._messages.envelope.topic or "image", calibration_of(info)
        known = self._models.get(topic)
        if known is not None and known[0] == told:
            return
        if known is None and len(self._models) >= MAX_CAMERAS:
            return
        try:
            self._models[topic] = (told, CameraModel.of(info))
        except NoFloor as error:
            self._models[topic] = (told, str(error))

    def see(self, name: str, image: Image | CompressedImage) -> None:
        """Find the floor in a new picture of a camera."""
        if self._pages:
            size = (image.width, image.height) if isinstance(image, Image) else None
            self._taken[name] = Taken(image.header.stamp.nanoseconds, image.header.frame_id, size)
            self._look(name)

    def _look(self, name: str) -> None:
        stamp_ns = self._taken[name].stamp_ns
        self._again.discard(name)
        try:
            found = PictureFloor(stamp_ns, self._view(name), "")
        except NoFloor as error:
            found = PictureFloor(stamp_ns, None, str(error))
        except (TooNew, TooOld):
            found = PictureFloor(stamp_ns, None, "where the camera was at that moment is not known")
        except SceneGraphError:
            found = PictureFloor(stamp_ns, None, "nobody tells where the camera is")
        self._floors[name] = found

    def _view(self, name: str) -> dict[str, object]:
        stamp_ns, frame, _ = self._taken[name]
        model = self._model(name)
        if self._is_too_new(frame, stamp_ns):
            self._again.add(name)
        X_CB = self._lately(BASE, frame, stamp_ns).inverse()
        X_MA = self._X_MA
        in_map: NDArray[np.float64] | None = None
        if X_MA is not None:
            in_map = (X_MA @ self._lately(self._anchor_frame, frame, stamp_ns)).inverse().matrix
        return {
            **model.described(),
            "base": rounded(plane(X_CB.matrix)),
            "map": None if in_map is None else rounded(plane(in_map)),
        }

    def _lately(self, a: str, b: str, time_ns: int) -> RigidTransform:
        """Return X_AB at a time, or the newest one if that is hardly older."""
        try:
            return self._graph.pose(a, b, time_ns)
        except TooNew:
            self._graph.pose(a, b, time_ns - LATE_NS)
            return self._graph.pose(a, b)

    def _is_too_new(self, frame: str, time_ns: int) -> bool:
        try:
            self._graph.pose(self._anchor_frame, frame, time_ns)
        except TooNew:
            return True
        except SceneGraphError:
            return False
        return False

    def _model(self, name: str) -> CameraModel:
        """Return the model of a camera, by the name of its pictures."""
        known, taken = self._models.get(name.removesuffix("/compressed")), self._taken.get(name)
        if known is None or taken is None:
            raise NoFloor("the camera does not tell how it is calibrated")
        model = known[1]
        if isinstance(model, str):
            raise NoFloor(model)
        if taken.size_px not in (None, (model.width, model.height)):
            raise NoFloor("the calibration of the camera is for pictures of another size")
        return model

    @property
    def _anchor_frame(self) -> str:
        return ODOM if ODOM in self._graph else MAP

    def tick(self) -> None:
        """Follow the corrections of the map, and answer what was asked."""
        if not self._pages and not self._waiting:
            return
        try:
            self._X_MA = None if self._lost() else self._graph.pose(MAP, self._anchor_frame)
        except SceneGraphError:
            self._X_MA = None
        for name in [*self._again]:
            self._look(name)
        while self._waiting:
            touch, future = self._waiting.popleft()
            if not future.set_running_or_notify_cancel():
                continue  # the page has not waited
            try:
                future.set_result(self._find(touch))
            except NoFloor as error:
                future.set_exception(error)
            except SceneGraphError:
                future.set_exception(NoFloor("where the camera was when it took that picture is not known"))

    def _lost(self) -> str:
        """Return why the robot's place on the map is not known; '' if it is."""
        born_s, mapping = self._births.of(self._pose), self._mapping.message
        if born_s is None:
            return "nobody tells where the robot is on a map"
        age_s = self._births.now_s() - born_s
        if age_s > MAX_POSE_AGE_S:
            return f"the robot's position on the map is {age_s:.0f} s old"
        return "the robot does not know where it is on the map" if mapping and not mapping.certain else ""

    def about(self, name: str, image: Image | CompressedImage) -> Mapping[str, object]:
        """Return what a page needs to draw on the floor of a picture. Any thread may call this."""
        stamp_ns = image.header.stamp.nanoseconds
        floor = self._floors.get(name)
        told: dict[str, object] = {"stamp": str(stamp_ns)}  # JavaScript has no such numbers
        if floor is not None and floor.stamp_ns == stamp_ns:
            told |= {"floor": floor.view, "no_floor": floor.why}
        return told

    def locate(self, touch: Touch) -> Future[Spot]:
        """Find the place on the floor that was pressed. Any thread may call this.

        Returns:
            The place, in a while; or a NoFloor that says why there is none.
        """
        future: Future[Spot] = Future()
        if len(self._waiting) >= MAX_WAITING:
            future.set_exception(NoFloor("the robot is busy: press again"))
        else:
            self._waiting.append((touch, future))
        return future

    def place_of(self, spot: Spot) -> tuple[float, float] | None:
        """Return where a place is on the map now, m; None if nobody knows. Any thread may call this."""
        X_MA = self._X_MA
        if X_MA is None:
            return None
        x_m, y_m, _ = X_MA.apply(spot.anchor).tolist()
        return x_m, y_m

    def forget(self) -> None:
        """Forget where the map was: time has jumped."""
        self._X_MA = None
        self._floors = {}

    def _find(self, touch: Touch) -> Spot:
        model = self._model(touch.camera)
        self._check_age(touch)
        if (why := self._lost()) or self._X_MA is None:
            raise NoFloor(why or "nobody tells where the robot is on a map")
        frame, stamp_ns = self._taken[touch.camera].frame, touch.stamp_ns
        X_BC = self._graph.pose(BASE, frame, stamp_ns)
        X_AC = self._graph.pose(self._anchor_frame, frame, stamp_ns)
        if self._turns(frame, stamp_ns):
            raise NoFloor("the camera was turning: press when it stands still")
        seen = floor_point(model, X_BC, touch.across, touch.down)
        anchor = (X_AC @ X_BC.inverse()).apply(seen)
        (x_m, y_m, _), eye = self._X_MA.apply(anchor).tolist(), (self._X_MA @ X_AC).translation
        distance_m = float(np.hypot(*(seen - X_BC.translation)[:2]))
        ax, ay, az = anchor.tolist()
        return Spot(x_m, y_m, (ax, ay, az), (float(eye[0]), float(eye[1])), distance_m)

    def _check_age(self, touch: Touch) -> None:
        age_s = (self._clock.now_ns() - touch.stamp_ns) / NS
        if not -AHEAD_S <= age_s <= MAX_AGE_S:
            raise NoFloor(f"that picture is {age_s:.1f} s old: press in a newer one")

    def _turns(self, frame: str, stamp_ns: int) -> bool:
        """Return whether a camera was turning on the robot."""
        try:
            before, after = (self._graph.pose(BASE, frame, stamp_ns + by) for by in (-TURNS_NS, TURNS_NS))
        except SceneGraphError:
            return False  # it has just begun to be known
        turn = before.inverse() @ after
        return 2.0 * math.acos(min(1.0, abs(turn.qw))) > TURNS_RAD


def calibration_of(info: CameraInfo) -> tuple[object, ...]:
    """Return what a camera tells of its calibration, to compare it."""
    binning, cut = (info.binning_x, info.binning_y), (info.roi.width, info.roi.height)
    return info.width, info.height, info.distortion_model, info.k.tobytes(), info.d.tobytes(), binning, cut


def plane(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) matrix that brings (x, y, 1) on the floor into the optical frame, of X_CW (4, 4)."""
    return np.asarray(matrix[:3, [0, 1, 3]])


def floor_point(model: CameraModel, X_BC: RigidTransform, across: float, down: float) -> NDArray[np.float64]:
    """Return the place (3,) on the floor, m in base_link, that a picture shows somewhere.

    Args:
        model: of the camera.
        X_BC: where the camera was.
        across: share of the picture's width, from the left.
        down: share of its height, from the top.

    Raises:
        NoFloor: it shows no floor there, or one that is too far away.
    """
    eye = X_BC.translation
    height_m = float(eye[2])
    if not height_m > LEAST_HEIGHT_M:
        raise NoFloor("by the scene graph, the camera is not above the floor")
    ray = model.ray(across * model.width - 0.5, down * model.height - 0.5)
    towards = X_BC.matrix[:3, :3] @ ray
    if not towards[2] < 0.0:
        raise NoFloor("that is above the horizon: press a place on the floor")
    seen: NDArray[np.float64] = eye + towards * (height_m / -towards[2])
    distance_m = float(np.hypot(*(seen - eye)[:2]))
    reach_m = reach_of(height_m)
    if not distance_m <= reach_m:
        away = f"{distance_m:.0f} m away" if distance_m < 100.0 else "at the horizon"
        raise NoFloor(f"that is {away}: press a place nearer than {reach_m:.1f} m")
    seen[2] = 0.0
    return seen


def reach_of(height_m: float) -> float:
    """Return up to which distance, m, a camera at some height measures where a place on the floor is."""
    return min(MAX_REACH_M, math.sqrt(MAX_SHIFT_M * height_m / TILT_RAD))


def checked(sent: Any) -> Touch | None:
    """Return what a page's script has sent, or None if it is malformed."""
    try:
        camera, stamp_ns = str(sent["camera"]), int(str(sent["stamp"])[:20])
        across, down = float(sent["across"]), float(sent["down"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    in_picture = 0.0 <= across <= 1.0 and 0.0 <= down <= 1.0
    return Touch(camera, stamp_ns, across, down) if in_picture and 0 <= stamp_ns < 1 << 63 else None
