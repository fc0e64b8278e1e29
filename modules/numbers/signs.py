"""Reads digits in the camera's images, and places them on the map where the laser sees a post."""

import json
import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Header, MessageHandling, Module, SettingError, setting
from robbie_mp.messages import (
    BoundingBox2D,
    CameraInfo,
    Detection2D,
    Detection2DArray,
    Image,
    LaserScan,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    OccupancyGrid,
    Point2D,
    PointOfInterest,
    PointsOfInterest,
    Pose2D,
)
from robbie_mp.scene import RigidTransform, SceneGraphError, SceneGraphListener, TooNew
from robbie_robots.modules.maps.planar_messages import map_cells, pose_stamped, sweep_of
from robbie_robots.modules.numbers.messages import NumberSigns
from robbie_robots.modules.sensor_deadlines import CAMERA_S, LASER_S
from robbie_robots.workers.numbers.board_pose import board_facing
from robbie_robots.workers.numbers.board_reader import BoardReader, BoardSighting
from robbie_robots.workers.numbers.digit_reader import ReaderMissing
from robbie_robots.workers.numbers.quadrangles import QuadranglesMissing
from robbie_robots.workers.numbers.sign_map import SheetVotes, Sign, SignMap
from robbie_robots.workers.numbers.sign_placing import SignView, distances_m, posts_on
from robbie_robots.workers.planar_pose import transform_points

TELL_PERIOD_S = 0.5
"""Time between messages about signs."""

TURNED_S, TURNED_RAD = 0.1, 0.03
"""An image is not used if the camera has turned by more than this angle in this time: its direction is not
known exactly, so a board might be placed on another post; and images of real cameras are blurred then."""
SCANS = 8


class NumberSignFinder(Module):
    """Finds numbered signs, and publishes them as `NumberSigns`, and as `PointsOfInterest` on topic `signs`.

    What it saw in an image is a `Detection2DArray` on the image's topic. Signs, and the order on the sheet,
    survive a restart. At the end it writes `signs.json` to the run's results: what it read on each post, and
    from where.
    """

    period_s: float = setting(0.1, "time between looks at new images", minimum=0.02)
    near_m: float = setting(
        1.6, "a look at a nearer post does not count: its board may be cut off", minimum=0.2
    )
    far_m: float = setting(3.2, "a look at a farther post does not count", minimum=0.5)
    scan_topic: str = setting("", "topic of the laser to use, if the robot has several; '' for any")
    max_range_m: float = setting(10.0, "farther ends of beams are not used", minimum=1.0)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check that what reads digits is installed before anything starts."""
        try:
            BoardReader()
        except (QuadranglesMissing, ReaderMissing) as error:
            raise SettingError(str(error)) from error

    def setup(self) -> None:
        """Create the workers; subscribe to camera, laser and map."""
        self.reader = BoardReader()
        self.signs = SignMap()
        self.sheet = SheetVotes()
        self.images = 0
        self.camera: CameraInfo | None = None
        self.image: Image | None = None
        self.scans: deque[LaserScan] = deque(maxlen=SCANS)
        self.told_s = -math.inf
        if self.restored is not None:
            self.signs.restore(self.restored["signs"])
            self.sheet = SheetVotes(self.restored["sheet"])
            self.images = self.restored["images"]
        self.scene = SceneGraphListener(self)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(CameraInfo, self.on_camera, newest, topic="camera")
        self.subscribe(Image, self.on_image, newest, topic="camera", deadline_s=CAMERA_S)
        self.subscribe(LaserScan, self.scans.append, topic=self.scan_topic, deadline_s=LASER_S)
        self.subscribe(OccupancyGrid, self.on_map, newest)

    def on_camera(self, camera: CameraInfo) -> None:
        """Store the camera's projection."""
        self.camera = camera if camera.is_calibrated else None

    def on_image(self, image: Image) -> None:
        """Keep the newest image until the camera's pose at its stamp is known."""
        self.image = image

    def on_map(self, grid: OccupancyGrid) -> None:
        """Take the posts of a new map."""
        self.signs.see_posts(posts_on(*map_cells(grid)))

    def tick(self) -> None:
        """Read the newest image, and tell what is known."""
        if self.image is not None and self.camera is not None and self.scans:
            self._look(self.image, self.camera)
        if self.monotonic_s() - self.told_s >= TELL_PERIOD_S:
            self.told_s = self.monotonic_s()
            self._tell()

    def teardown(self) -> None:
        """Write what was read on each post."""
        signs = [
            {
                "text": sign.text,
                "xy_m": sign.xy_m.round(3).tolist(),
                "facing_rad": None if math.isnan(sign.facing_rad) else round(sign.facing_rad, 3),
                "places": [[*place.xy_m, place.votes] for place in sign.places],
                "glimpses": sign.glimpses,
            }
            for sign in self.signs.signs
        ]
        self.write_result("signs.json", json.dumps(signs) + "\n")

    def _look(self, image: Image, camera: CameraInfo) -> None:
        """Read an image, as soon as the camera's pose is known."""
        stamp_ns = image.header.stamp.nanoseconds
        scan = min(self.scans, key=lambda one: abs(one.header.stamp.nanoseconds - stamp_ns))
        try:
            X_MC = self.scene.pose("map", image.header.frame_id, stamp_ns)
            before = self.scene.pose("map", image.header.frame_id, stamp_ns - round(TURNED_S * 1e9))
            X_ML = self.scene.pose("map", scan.header.frame_id, scan.header.stamp.nanoseconds)
        except TooNew:
            return  # the transforms have not arrived yet
        except SceneGraphError as error:
            self.log.debug("could not use an image: %s", error)
            self.image = None
            return
        self.image = None
        eye = (X_MC.x, X_MC.y, _heading(X_MC))
        if abs(math.remainder(eye[2] - _heading(before), math.tau)) > TURNED_RAD:
            return
        self.images += 1
        pixels = image.data.reshape(image.height, image.step)[:, : 3 * image.width]
        pixels = np.ascontiguousarray(pixels).reshape(image.height, image.width, 3)
        sightings = self.reader.read(pixels)
        detections = [detection(image.header, one) for one in sightings]
        self.publish(Detection2DArray(header=image.header, detections=detections), topic="camera")
        half_width_rad = math.atan(camera.width / 2 / float(camera.k[0]))
        view = SignView(eye, half_width_rad, self._points(scan, X_ML))
        for sighting in sightings:
            if sighting.is_sheet:
                self.sheet.see(sighting.text)
            else:
                self._place(sighting, view, X_MC, camera)
        for sign in self.signs.signs:
            if view.shows(sign.xy_m, self.near_m, self.far_m):
                self.signs.look(sign, eye)
        self._remember()

    def _place(
        self, sighting: BoardSighting, view: SignView, X_MC: RigidTransform, camera: CameraInfo
    ) -> None:
        """Add a board to the map, if the laser sees a post below it."""
        quadrangle = sighting.quadrangle
        focal_px, centre_px = float(camera.k[0]), (float(camera.k[2]), float(camera.k[5]))
        column, row = quadrangle.middle_px
        ray = X_MC.apply(((column - centre_px[0]) / focal_px, (row - centre_px[1]) / focal_px, 1.0))
        x, y = (ray - X_MC.translation)[:2].tolist()
        near_m, far_m = distances_m(quadrangle.height_px, focal_px)
        post = view.post_along(math.atan2(y, x), near_m, far_m, self.signs.posts_m)
        if post is None:
            return
        if sighting.text:
            slant_rad = board_facing(quadrangle, focal_px, centre_px)
            facing_rad = math.atan2(y, x) + math.pi + slant_rad
            self.signs.see(sighting.text, post, facing_rad, view.eye, quadrangle.height_px)
        else:
            width = quadrangle.width_px / quadrangle.height_px
            self.signs.see_other(post, view.eye, quadrangle.height_px, width)

    def _points(self, scan: LaserScan, X_ML: RigidTransform) -> NDArray[np.float64]:
        """Return the ends of a scan's beams: (N, 2), m, map frame."""
        ends = sweep_of(scan).points(self.max_range_m)
        return transform_points((X_ML.x, X_ML.y, _turn(X_ML)), ends)

    def _tell(self) -> None:
        """Publish all signs, and show which digits and how many open posts there are."""
        signs = self.signs.signs
        codes = [_digit(sign) for sign in signs]
        found = "".join(sorted(str(code) for code in codes if code >= 0))
        open_posts = codes.count(NumberSigns.UNKNOWN)
        self.status = f"digits {found or 'none'}; {open_posts} open posts; {self.images} images"
        header = Header(stamp=self.now(), frame_id="map")
        places = np.array([sign.xy_m for sign in signs]).reshape(-1, 2)
        self.publish(
            NumberSigns(
                header=header,
                x_m=places[:, 0].copy(),
                y_m=places[:, 1].copy(),
                facing_rad=np.array([sign.facing_rad for sign in signs], np.float64),
                digits=np.array(codes, np.int8),
                likely=np.array([int(sign.likely or NumberSigns.UNKNOWN) for sign in signs], np.int8),
                views=np.array([sign.times(sign.likely) for sign in signs], np.uint16),
                searched=np.array([sign.searched for sign in signs], np.uint16),
                sheet=self.sheet.order,
                images=self.images,
            )
        )
        points = [
            PointOfInterest(name=str(code), pose=pose_stamped([*sign.xy_m, sign.facing_rad], header).pose)
            for sign, code in zip(signs, codes, strict=True)
            if code >= 0
        ]
        self.publish(PointsOfInterest(header=header, points=points), topic="signs")

    def _remember(self) -> None:
        self.checkpoint({"signs": self.signs.state(), "sheet": self.sheet.order, "images": self.images})


def _digit(sign: Sign) -> int:
    """Return a sign's digit as in the message."""
    if text := sign.text:
        return int(text)
    return NumberSigns.UNKNOWN if sign.is_open else NumberSigns.OTHER


def _heading(X_MC: RigidTransform) -> float:
    """Return the direction of a camera's optical axis, rad, in the frame M."""
    ahead = X_MC.apply((0.0, 0.0, 1.0)) - X_MC.translation
    return math.atan2(ahead[1], ahead[0])


def _turn(X_ML: RigidTransform) -> float:
    """Return the direction of a laser's x axis, rad, in the frame M."""
    ahead = X_ML.apply((1.0, 0.0, 0.0)) - X_ML.translation
    return math.atan2(ahead[1], ahead[0])


def detection(header: Header, sighting: BoardSighting) -> Detection2D:
    """Return the place of a board in its image."""
    corners = sighting.quadrangle.corners_px
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y = ((low + high) / 2).tolist()
    size_x, size_y = (high - low).tolist()
    hypothesis = ObjectHypothesis(class_id=sighting.text or "board", score=sighting.confidence)
    return Detection2D(
        header=header,
        results=[ObjectHypothesisWithPose(hypothesis=hypothesis)],
        bbox=BoundingBox2D(center=Pose2D(position=Point2D(x=x, y=y)), size_x=size_x, size_y=size_y),
        id=sighting.text,
    )
