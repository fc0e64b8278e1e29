"""Finds a table and what stands on it in the images of a depth camera."""

from pathlib import Path

import numpy as np
import yaml

from modules.manipulation.shape_messages import view_message
from robbie_mp import REQUIRED, Header, MessageHandling, Module, SettingError, setting
from robbie_mp.messages import (
    CameraInfo,
    Image,
    PointOfInterest,
    PointsOfInterest,
)
from robbie_mp.scene_graph import RigidTransform, SceneGraphError, SceneGraphListener
from robbie_mp.scene_graph.conversion import to_pose
from workers.manipulation.rotations import quaternion_of
from workers.manipulation.table_view import KnownObject, TableFinder, TableView, points_of

BASE = "base_link"


class ObjectFileError(SettingError):
    """The file of known objects is invalid."""


class TableObjectFinder(Module):
    """Publishes `TableObjects` for each image on topic `depth` that shows a table in front of the robot.

    Objects are named by their shape and size. On the map they are `PointsOfInterest` on topic `objects`.
    """

    objects: Path = setting(REQUIRED, "file of the known objects (YAML)", must_exist=True)
    tolerance_m: float = setting(0.015, "largest error of a measured size", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the known objects, so that a mistake is reported before anything starts."""
        file = settings["objects"]
        assert isinstance(file, Path)
        read_objects(file)

    def setup(self) -> None:
        """Create the worker; subscribe to the camera."""
        self.finder = TableFinder(read_objects(self.objects), tolerance_m=self.tolerance_m)
        self.scene = SceneGraphListener(self)
        self.camera: CameraInfo | None = None
        self.images = 0
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(CameraInfo, self.on_camera, newest, topic="depth")
        self.subscribe(Image, self.on_image, newest, topic="depth")

    def on_camera(self, camera: CameraInfo) -> None:
        """Store the camera's projection."""
        self.camera = camera

    def on_image(self, image: Image) -> None:
        """Search an image."""
        if self.camera is None:
            return
        if image.encoding != "16UC1":
            self.status = f"images must be 16UC1, not {image.encoding}"
            return
        try:
            X_BC = self.scene.pose(BASE, image.header.frame_id)
        except SceneGraphError as error:
            self.status = str(error)
            return
        k = self.camera.k
        depths = image.data.view("<u2").reshape(image.height, image.step // 2)[:, : image.width]
        points = X_BC.apply(points_of(depths, float(k[0]), (float(k[2]), float(k[5]))))
        stamp_s = image.header.stamp.nanoseconds / 1e9
        view = self.finder.find(points, stamp_s, 1.0 / float(k[0]), X_BC.translation)
        self.images += 1
        if view is None:
            self.status = f"no table; {self.images} images"
            return
        header = Header(stamp=image.header.stamp, frame_id=BASE)
        self.publish(view_message(view, header))
        self._show_on_map(view, image)
        names = ", ".join(shape.name for shape in view.objects) or "nothing"
        self.status = f"table {view.top_m:.2f} m high with {names}; {self.images} images"

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


def read_objects(file: Path) -> list[KnownObject]:
    """Return the known objects of a YAML file.

    It is a map of names to `can: [diameter, height]` or `box: [x, y, z]`, in m.

    Raises:
        ObjectFileError: the file is invalid; the text says where.
    """
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise ObjectFileError(f"{file}: {error}", "objects") from error
    if not isinstance(content, dict) or not content:
        raise ObjectFileError(f"{file}: expected a map of names to shapes", "objects")
    known = []
    for name, shape in content.items():
        kind, sizes = next(iter(shape.items())) if isinstance(shape, dict) and len(shape) == 1 else ("", [])
        count = {"can": 2, "box": 3}.get(kind, 0)
        numbers = np.array([size for size in sizes if isinstance(size, int | float)], np.float64)
        if not count or len(sizes) != count or len(numbers) != count or not (numbers > 0).all():
            what = "expected `can: [diameter, height]` or `box: [x, y, z]` in m"
            raise ObjectFileError(f"{file}: {name}: {what}", "objects")
        x, y, z = numbers if kind == "box" else (numbers[0], *numbers)
        known.append(KnownObject(str(name), (float(x), float(y), float(z)), kind == "can"))
    return known
