"""People around the robot: legs in the laser's scans, and clothes in the camera's pictures."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Header, MessageHandling, Module, Time, setting
from robbie_mp.messages import (
    CameraInfo,
    Image,
    LaserScan,
    OccupancyGrid,
    Point,
    PointOfInterest,
    PointsOfInterest,
    Pose,
)
from robbie_mp.scene import RigidTransform, SceneGraphError, SceneGraphListener, TooNew
from robbie_robots.modules.maps.planar_messages import map_cells, sweep_of
from robbie_robots.modules.people.messages import People, PeopleClothes, Person
from robbie_robots.modules.sensor_deadlines import CAMERA_S, LASER_S
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.people.clothes import ClothesView, clothes_in
from robbie_robots.workers.people.leg_classifier import LegClassifier
from robbie_robots.workers.people.leg_segments import find_segments
from robbie_robots.workers.people.map_things import MapThings
from robbie_robots.workers.people.person_tracker import PersonTracker, TrackedPerson, TrackerSettings
from robbie_robots.workers.planar_pose import transform_points

SCANS = 5
PEOPLE, THINGS = "people", "things_like_people"
"""Topics of `People`: persons; and what looks like legs, but is on the map and has not moved."""
HIDES_M = 0.3
"""Something hides a place from the laser if it is nearer by this."""
SEEN_S = 0.3
"""The clothes of a person whose legs were not seen for this time are not looked at."""


class PeopleFinder(Module):
    """Finds persons by their legs; publishes `People` and, if there is a camera, `PeopleClothes`.

    Needs `LaserScan`, of one laser or several, and the transforms of the scene graph; uses `OccupancyGrid`,
    so that what is on the map counts as a person only once it moves. Persons are on topic `people`. What is
    not a person yet is among the `People` on topic `things_like_people`, for tasks that find out by other
    means who stands there. The page shows the persons as `PointsOfInterest` on topic `people`. They keep
    their names over a restart.
    """

    period_s: float = setting(0.1, "time between looks at new scans and pictures", minimum=0.02)
    max_range_m: float = setting(6.0, "farther legs are not looked for", minimum=1.0)

    def setup(self) -> None:
        """Create the workers; subscribe to laser, camera and map."""
        self.classifier = LegClassifier.from_file()
        self.tracker = PersonTracker(TrackerSettings())
        if self.restored is not None:
            self.tracker.remember(self.restored)
        self.things: MapThings | None = None
        self.scans: dict[str, deque[LaserScan]] = {}
        self.stamp = Time()
        self.camera: CameraInfo | None = None
        self.image: Image | None = None
        self.seen = self.pictures = self.unplaced = 0
        self.scene = SceneGraphListener(self)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(LaserScan, self.on_scan, deadline_s=LASER_S)
        self.subscribe(OccupancyGrid, self.on_map, newest, optional=True)
        self.subscribe(CameraInfo, self.on_camera, newest, topic="camera", optional=True)
        self.subscribe(Image, self.on_image, newest, topic="camera", optional=True, deadline_s=CAMERA_S)

    def on_scan(self, scan: LaserScan) -> None:
        """Keep the newest scans of each laser, by its frame, until their poses are known."""
        self.scans.setdefault(scan.header.frame_id, deque(maxlen=SCANS)).append(scan)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Take what the newest map shows."""
        self.things = MapThings(*map_cells(grid))

    def on_camera(self, camera: CameraInfo) -> None:
        """Store the camera's projection."""
        self.camera = camera if camera.is_calibrated else None

    def on_image(self, image: Image) -> None:
        """Keep the newest picture until the camera's pose at its stamp is known."""
        self.image = image

    def tick(self) -> None:
        """Track the persons in all scans whose poses are known, and look at the newest picture."""
        was_seen = self.seen
        while (waiting := self._oldest()) is not None and self._take_scan(waiting[0]):
            waiting.popleft()
        if self.seen != was_seen:
            self._tell()
            self.checkpoint(self.tracker.memory())
        if self.image is not None and self.camera is not None:
            self._look(self.image, self.camera)
        persons = self.tracker.persons
        self.status = (
            f"{sum(one.unseen_s <= SEEN_S for one in persons)} persons seen; {self.seen} scans, "
            f"{self.unplaced} without a pose, {self.pictures} pictures, {self.tracker.dropped} tracks dropped"
        )

    def _oldest(self) -> deque[LaserScan] | None:
        """Return the scans of the laser whose first one is the oldest; None if none waits."""
        waiting = [scans for scans in self.scans.values() if scans]
        return min(waiting, key=lambda scans: scans[0].header.stamp.nanoseconds, default=None)

    def _take_scan(self, scan: LaserScan) -> bool:
        """Track the persons in a scan; return False if its pose is not known yet."""
        stamp = scan.header.stamp
        try:
            X_ML = self.scene.pose("map", scan.header.frame_id, stamp.nanoseconds)
        except TooNew:
            return False
        except SceneGraphError as error:
            self.log.debug("could not place a scan: %s", error)
            self.unplaced += 1
            return True
        laser = _planar(X_ML)
        sweep = sweep_of(scan)
        segments = find_segments(sweep, self.max_range_m)
        legs = transform_points(laser, segments.centres_m)
        on_map = np.zeros(len(legs), np.bool_) if self.things is None else self.things.at(legs)
        likely = self.classifier.probabilities(segments.features)

        def is_hidden(xy_m: NDArray[np.float64]) -> bool:
            return hides(sweep, laser, xy_m)

        stamp_s = stamp.nanoseconds / 1e9
        self.tracker.see(stamp_s, legs, likely, on_map, is_hidden, scan.header.frame_id)
        # The persons have the newest stamp; scans of another laser may be a little older.
        if stamp_s >= self.tracker.now_s or stamp.nanoseconds > self.stamp.nanoseconds:
            self.stamp = stamp
        self.seen += 1
        return True

    def _tell(self) -> None:
        """Publish all persons."""
        header = Header(stamp=self.stamp, frame_id="map")
        persons = self.tracker.persons
        self.publish(People(header=header, people=[message_of(one) for one in persons]), topic=PEOPLE)
        things = [message_of(one) for one in self.tracker.things]
        self.publish(People(header=header, people=things), topic=THINGS)
        points = [
            PointOfInterest(name=f"person {one.number}", pose=Pose(position=_point(one.xy_m)))
            for one in persons
            if one.unseen_s <= SEEN_S
        ]
        self.publish(PointsOfInterest(header=header, points=points), topic=PEOPLE)

    def _look(self, image: Image, camera: CameraInfo) -> None:
        """Publish how the persons in a picture are dressed, as soon as the camera's pose is known."""
        stamp_ns = image.header.stamp.nanoseconds
        try:
            X_MC = self.scene.pose("map", image.header.frame_id, stamp_ns)
        except TooNew:
            return
        except SceneGraphError as error:
            self.log.debug("could not use a picture: %s", error)
            self.image = None
            return
        self.image = None
        self.pictures += 1
        persons = [one for one in self.tracker.persons if one.unseen_s <= SEEN_S]
        if not persons:
            return
        ahead_s = stamp_ns / 1e9 - self.stamp.nanoseconds / 1e9
        places = np.array([one.xy_m + ahead_s * one.velocity_m_per_s for one in persons])
        pixels = image.data.reshape(image.height, image.step)[:, : 3 * image.width]
        view = ClothesView(
            pixels.reshape(image.height, image.width, 3),
            float(camera.k[0]),
            (float(camera.k[2]), float(camera.k[5])),
            X_MC.matrix[:3, :3].T,
            X_MC.translation,
        )
        worn = [
            (str(one.number), clothes)
            for one, clothes in zip(persons, clothes_in(view, places), strict=True)
            if clothes is not None
        ]
        if worn:
            self.publish(
                PeopleClothes(
                    header=image.header,
                    names=[name for name, _ in worn],
                    clothes=np.concatenate([clothes for _, clothes in worn]).astype(np.float32),
                )
            )


def hides(sweep: LaserSweep, laser: NDArray[np.float64], xy_m: NDArray[np.float64]) -> bool:
    """Return whether a sweep shows something in front of a place.

    Args:
        sweep: the sweep.
        laser: (3,), pose of the laser, map frame.
        xy_m: (2,), m, map frame.
    """
    x, y = xy_m - laser[:2]
    beam = int(sweep.beams_at(np.arctan2(y, x) - laser[2]))
    if beam >= len(sweep):
        return True  # the laser does not look there
    seen_m = float(sweep.ranges_m[beam])
    return math.isfinite(seen_m) and seen_m < math.hypot(x, y) - HIDES_M


def message_of(person: TrackedPerson) -> Person:
    """Return the message for a person."""
    return Person(
        name=str(person.number),
        position=_point(person.xy_m),
        velocity=_point(person.velocity_m_per_s),
        reliability=person.confidence,
        tagnames=["unseen_s", "has_moved", "two_legs"],
        tags=[f"{person.unseen_s:.3f}", str(int(person.has_moved)), f"{person.two_legs:.2f}"],
    )


def reports_of(message: People, now_ns: int) -> list[PersonReport]:
    """Return the persons of a message as the tasks take them; their age counts from now."""
    age_s = max(0.0, (now_ns - message.header.stamp.nanoseconds) / 1e9)
    return [
        PersonReport(
            one.name,
            (one.position.x, one.position.y),
            (one.velocity.x, one.velocity.y),
            number_of(one, "unseen_s", math.inf) + age_s,
            number_of(one, "has_moved", 0.0) > 0.0,
            one.reliability,
            number_of(one, "two_legs", 1.0),
        )
        for one in message.people
    ]


def number_of(person: Person, tag: str, unknown: float) -> float:
    """Return a number that a message tells of a person; `unknown` if it does not."""
    try:
        return float(dict(zip(person.tagnames, person.tags, strict=False))[tag])
    except (KeyError, ValueError):
        return unknown


def _point(xy: NDArray[np.float64]) -> Point:
    return Point(x=float(xy[0]), y=float(xy[1]))


def _planar(X_ML: RigidTransform) -> NDArray[np.float64]:
    """Return the laser's x, y (m) and heading (rad), map frame."""
    ahead = X_ML.apply((1.0, 0.0, 0.0)) - X_ML.translation
    return np.array([X_ML.x, X_ML.y, math.atan2(ahead[1], ahead[0])])
