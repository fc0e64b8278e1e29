"""Finds a table and what stands on it in the images of a depth camera."""

from collections import deque
from pathlib import Path

import numpy as np

from robbie_mp import REQUIRED, Header, MessageHandling, Module, SettingError, setting
from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import read_file
from robbie_mp.messages import (
    CameraInfo,
    Detection2DArray,
    Image,
    PointOfInterest,
    PointsOfInterest,
    TaughtNames,
)
from robbie_mp.scene import RigidTransform, SceneGraphError, SceneGraphListener
from robbie_mp.scene.conversion import to_pose
from robbie_robots.modules.manipulation.shape_messages import view_message
from robbie_robots.modules.sensor_deadlines import CAMERA_S
from robbie_robots.workers.manipulation.object_names import Prints
from robbie_robots.workers.manipulation.rotations import quaternion_of
from robbie_robots.workers.manipulation.table_view import KnownObject, TableFinder, TableView, points_of
from robbie_robots.workers.taught import Box, Sighting

BASE = "base_link"
TAUGHT = "objects"
"""The topic on which the names of taught objects are published."""
SAME_TIME_S = 0.05
"""A depth image and a picture belong together if they were taken within this time."""
WAIT_S = 2.0
"""A depth image waits this long for what is recognized in its picture."""
MAX_WAITING = 8
LARGEST_M = 2.0
"""Edge of an object: sizes in mm or cm are mistakes."""


class ObjectFileError(SettingError):
    """The file of known objects is invalid."""


class TableObjectFinder(Module):
    """Publishes `TableObjects` for each image on topic `depth` that shows a table in front of the robot.

    Objects have the names that were taught for what is printed on them, if `TaughtObjects` recognizes that in
    the colour pictures; other objects are named by their shape and size. On the map they are
    `PointsOfInterest` on topic `objects`.
    """

    objects: Path = setting(REQUIRED, "file of the known objects (YAML)", must_exist=True)
    tolerance_m: float = setting(0.015, "largest error of a measured size", minimum=0.001)
    pictures: str = setting("", "topic of colour pictures taken together with the depth images; '': none")
    certain: float = setting(
        0.7, "minimum confidence with which an object is recognized", minimum=0.0, maximum=1.0
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the known objects, so that a mistake is reported before anything starts."""
        file = settings["objects"]
        assert isinstance(file, Path)
        read_objects(file)

    def setup(self) -> None:
        """Create the worker; subscribe to the cameras."""
        known = read_objects(self.objects)
        self.finder = TableFinder(known, tolerance_m=self.tolerance_m, certain=self.certain)
        if self.restored is not None:
            self.finder.namer.remember(self.restored)
        self.scene = SceneGraphListener(self)
        self.camera: CameraInfo | None = None
        self.picture_camera: CameraInfo | None = None
        self.taught: frozenset[str] = frozenset()
        self.teacher = ""
        self.found: Detection2DArray | None = None
        self.waiting: deque[Image] = deque()
        self.images = self.alone = self.skipped = 0
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(CameraInfo, self.on_camera, newest, topic="depth")
        self.subscribe(Image, self.on_image, newest, topic="depth", deadline_s=CAMERA_S)
        if self.pictures:
            self.subscribe(TaughtNames, self.on_taught, newest, topic=TAUGHT, optional=True)
            self.subscribe(CameraInfo, self.on_picture_camera, newest, topic=self.pictures, optional=True)
            self.subscribe(Detection2DArray, self.on_found, topic=self.pictures, optional=True)

    def on_camera(self, camera: CameraInfo) -> None:
        """Store the projection of the depth images."""
        self.camera = camera if camera.is_calibrated else None

    def on_picture_camera(self, camera: CameraInfo) -> None:
        """Store the projection of the pictures."""
        self.picture_camera = camera if camera.is_calibrated else None

    def on_taught(self, taught: TaughtNames) -> None:
        """Know which objects can be recognized."""
        self.taught, self.teacher = frozenset(taught.names), self.envelope.sender
        if not self.taught:
            self.waiting.clear()  # what waits would come too late

    def on_image(self, image: Image) -> None:
        """Search an image, as soon as it is known what its picture shows."""
        if not self.taught:
            self._look(image, None)
            return
        if len(self.waiting) == MAX_WAITING:
            self._skip()
        self.waiting.append(image)
        while _apart_s(self.waiting[0], image) > WAIT_S:
            self.alone += 1
            self._look(self.waiting.popleft(), None)
        self._join()

    def on_found(self, found: Detection2DArray) -> None:
        """Take what is recognized in a picture; other modules may have found other things in it."""
        if self.envelope.sender == self.teacher:
            self.found = found
            self._join()

    def _join(self) -> None:
        """Search the image that belongs to the newest picture; older ones are not needed any more."""
        found = self.found
        if found is None or not any(_apart_s(found, image) <= SAME_TIME_S for image in self.waiting):
            return
        while _apart_s(found, self.waiting[0]) > SAME_TIME_S:
            self._skip()
        self._look(self.waiting.popleft(), found)

    def _skip(self) -> None:
        """Drop the oldest image that waits: no picture of its time was searched."""
        self.waiting.popleft()
        self.skipped += 1

    def _prints(self, found: Detection2DArray | None) -> Prints | None:
        """Return what is recognized, as the worker takes it; None if nothing was taught."""
        if not self.taught:
            return None
        camera = self.picture_camera
        if found is None or camera is None:
            return Prints((), self.taught, np.eye(4), 1.0, (0.0, 0.0))
        X_CB = self.scene.pose(camera.header.frame_id, BASE).matrix
        k = camera.k
        sightings = []
        for one in found.detections:
            middle, wide, high = one.bbox.center.position, one.bbox.size_x, one.bbox.size_y
            box = Box(middle.x - wide / 2, middle.y - high / 2, wide, high)
            sightings += [Sighting(r.hypothesis.class_id, r.hypothesis.score, box) for r in one.results]
        taught = [one for one in sightings if one.name in self.taught]
        return Prints(tuple(taught), self.taught, X_CB, float(k[0]), (float(k[2]), float(k[5])))

    def _look(self, image: Image, found: Detection2DArray | None) -> None:
        """Search an image, and publish what it shows."""
        if self.camera is None:
            return
        if image.encoding != "16UC1":
            self.status = f"images must be 16UC1, not {image.encoding}"
            return
        try:
            X_BC = self.scene.pose(BASE, image.header.frame_id)
            prints = self._prints(found)
        except SceneGraphError as error:
            self.status = str(error)
            return
        k = self.camera.k
        depths = image.data.view("<u2").reshape(image.height, image.step // 2)[:, : image.width]
        points = X_BC.apply(points_of(depths, float(k[0]), (float(k[2]), float(k[5]))))
        stamp_s = image.header.stamp.nanoseconds / 1e9
        view = self.finder.find(points, stamp_s, 1.0 / float(k[0]), X_BC.translation, prints)
        self.checkpoint(self.finder.namer.memory())
        self.images += 1
        counts = f"{self.images} images, {self.alone} without a picture, {self.skipped} skipped"
        if view is None:
            self.status = f"no table; {counts}"
            return
        header = Header(stamp=image.header.stamp, frame_id=BASE)
        self.publish(view_message(view, header))
        self._show_on_map(view, image)
        names = ", ".join(shape.name for shape in view.objects) or "nothing"
        self.status = f"table {view.top_m:.2f} m high with {names}; {counts}"

    def _show_on_map(self, view: TableView, image: Image) -> None:
        """Publish where the objects are on the map, as soon as the robot knows where it is."""
        try:
            X_MB = self.scene.pose("map", BASE)
        except SceneGraphError:
            return
        points = [
            PointOfInterest(
                name=shape.name,
                pose=to_pose(
                    X_MB
                    @ RigidTransform.of(
                        shape.pose[:3, 3].tolist(), quaternion_of(shape.pose[:3, :3]).tolist()
                    )
                ),
            )
            for shape in view.objects
        ]
        header = Header(stamp=image.header.stamp, frame_id="map")
        self.publish(PointsOfInterest(header=header, points=points), topic="objects")


def _apart_s(one: Image | Detection2DArray, other: Image) -> float:
    """Return the time between two images, s."""
    return abs(one.header.stamp.nanoseconds - other.header.stamp.nanoseconds) / 1e9


def read_objects(file: Path) -> list[KnownObject]:
    """Return the known objects of a YAML file.

    It is a map of names to `can: [diameter, height]` or `box: [x, y, z]`, in m.

    Raises:
        ObjectFileError: the file is invalid; the text says where.
    """
    try:
        content = read_file(file).plain()
    except ProfileError as error:
        raise ObjectFileError(str(error), "objects") from error
    if not isinstance(content, dict) or not content:
        raise ObjectFileError(f"{file}: expected a map of names to shapes", "objects")
    known = []
    for name, shape in content.items():
        kind, sizes = next(iter(shape.items())) if isinstance(shape, dict) and len(shape) == 1 else ("", [])
        numbers = [float(size) for size in sizes if type(size) in (int, float)] if type(sizes) is list else []
        is_shape = len(numbers) == len(sizes) == {"can": 2, "box": 3}.get(kind) if numbers else False
        if not is_shape or not all(0 < number <= LARGEST_M for number in numbers):
            what = f"expected `can: [diameter, height]` or `box: [x, y, z]`, in m and at most {LARGEST_M:g}"
            raise ObjectFileError(f"{file}: {name}: {what}", "objects")
        x, y, z = numbers if kind == "box" else (numbers[0], *numbers)
        known.append(KnownObject(name, (x, y, z), kind == "can"))
    return known
