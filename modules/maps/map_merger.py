"""The map of a team: merges this robot's map with those of other robots."""

import math

import numpy as np
from numpy.typing import NDArray

from robbie_mp import REQUIRED, Header, Module, SettingError, setting
from robbie_mp.messages import (
    MapMetaData,
    OccupancyGrid,
    Point,
    Pose,
    PoseStamped,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_robots.modules.maps.planar_messages import map_cells, planar, pose_stamped
from robbie_robots.modules.rescue.team_messages import MapAlignment
from robbie_robots.workers.maps.map_alignment import Alignment, GridMap, Trust, align, merged, without_robot
from robbie_robots.workers.planar_pose import transform_points

ALIGN_PERIOD_S = 5.0
"""Time between searches for the place of a map."""

TRAIL_STEP_M = 0.1
MAX_TRAIL = 4000
"""Places kept of each robot; when there are more, every second one is forgotten."""


class MapMerger(Module):
    """Finds where the maps of other robots lie in this robot's map, and publishes one map of all.

    It publishes the team's map as `OccupancyGrid` on `team`, in this robot's map frame. It contains another
    robot's map only while its place is known, or is sure because the maps agree. `MapAlignment` says how sure
    that is, or why not. On `placed` it tells the scene graph where the other robots' maps are.

    This robot's laser also sees the other robots, and maps them as walls. The team's map leaves them out:
    where another robot is or was, by the poses on topics such as `blue/map_pose`, there is no wall.

    The other robots' maps arrive on topics with their names in front, such as `blue/own`; a link with
    `prefix_topics` publishes them so. This robot's map has the topic `own`: set `map_topic` of mapping.

        map_merger:
          class: robbie_robots.modules.maps.map_merger:MapMerger
          settings: {robots: [blue], starts: {blue: [0.0, 1.0, 0.0]}}
    """

    robots: list[str] = setting(REQUIRED, "names of the other robots")
    starts: dict[str, list[float]] = setting(
        {}, "x, y (m) and heading (rad) of another robot's map in this robot's, where known within 0.5 m"
    )
    map_topic: str = setting("own", "topic of this robot's own map")
    period_s: float = setting(1.0, "time between maps of the team", minimum=0.05)
    least_walls_m: float = setting(
        Trust.least_walls_m, "length of wall that must be on both maps", minimum=0.1
    )
    least_agreement: float = setting(
        Trust.least_agreement, "share of the walls that must lie on walls", minimum=0.0, maximum=1.0
    )
    most_ambiguous: float = setting(
        Trust.most_ambiguous,
        "how well another pose may fit, compared with the best",
        minimum=0.0,
        maximum=1.0,
    )
    footprint_m: float = setting(
        0.25, "another robot's radius; walls of the map this near to where it was are no walls", minimum=0.0
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the other robots' starts."""
        robots, starts = settings["robots"], settings["starts"]
        assert isinstance(robots, list)
        assert isinstance(starts, dict)
        for robot, start in starts.items():
            if robot not in robots:
                raise SettingError(f"{robot!r} is none of the robots {', '.join(robots)}", "starts")
            if len(start) != 3 or not all(math.isfinite(number) for number in start):
                raise SettingError(f"{robot}: expected x, y (m) and heading (rad), not {start}", "starts")

    def setup(self) -> None:
        """Subscribe to the maps."""
        self.trust = Trust(self.least_walls_m, self.least_agreement, self.most_ambiguous)
        self.own: GridMap | None = None
        self.others: dict[str, GridMap] = {}
        self.places: dict[str, NDArray[np.float64]] = {
            robot: np.array(start, float) for robot, start in self.starts.items()
        }
        self.found: dict[str, Alignment] = {}
        self.trails: dict[str, list[tuple[float, float]]] = {robot: [] for robot in self.robots}
        """Where each other robot was, x and y (m) in its own map."""
        self.next_s = dict.fromkeys(self.robots, 0.0)
        self.refused = 0
        self.is_new = False
        if self.restored is not None:
            self.places |= {
                robot: np.array(pose)
                for robot, pose in self.restored["places"].items()
                if robot in self.robots
            }
            for robot, trail in self.restored["trails"].items():
                if robot in self.trails:
                    self.trails[robot] = [(x_m, y_m) for x_m, y_m in trail.tolist()]
        self.is_unsaved = False
        self.subscribe(OccupancyGrid, self.on_map, topic=self.map_topic)
        for robot in self.robots:
            self.subscribe(OccupancyGrid, self.on_map, topic=f"{robot}/{self.map_topic}", optional=True)
            self.subscribe(PoseStamped, self.on_pose, topic=f"{robot}/map_pose", optional=True)

    def on_map(self, message: OccupancyGrid) -> None:
        """Keep the newest map of each robot."""
        topic = self.envelope.topic
        if not len(message.data):
            self.refused += 1
            self.log.warning("a map on %s is empty; it is ignored", topic)
            return
        grid = map_cells(message)
        kept = GridMap(grid.cells.copy(), grid.resolution_m, grid.corner_xy_m)
        self.is_new = True
        if topic == self.map_topic:
            self.own = kept
        else:
            self.others[topic.removesuffix(f"/{self.map_topic}")] = kept

    def on_pose(self, message: PoseStamped) -> None:
        """Remember where another robot is."""
        trail = self.trails[self.envelope.topic.removesuffix("/map_pose")]
        x_m, y_m, _ = planar(message.pose)
        if trail and math.dist(trail[-1], (x_m, y_m)) < TRAIL_STEP_M:
            return
        trail.append((x_m, y_m))
        self.is_unsaved = True
        if len(trail) > MAX_TRAIL:
            del trail[-2::-2]

    def tick(self) -> None:
        """Look for one map, and publish the map of all."""
        if self.own is None:
            self._save()
            self.status = "waiting for this robot's map"
            return
        self._align_one(self.own)
        self._save()
        if self.is_new:
            self.is_new = False
            self._publish(self.own)
        self._place()
        self.status = "; ".join(self._described(robot) for robot in self.robots)

    def _align_one(self, own: GridMap) -> None:
        """Look for the map whose turn it is: a search takes a second or less."""
        now_s = self.monotonic_s()
        robot = min(self.others, key=lambda one: self.next_s[one], default=None)
        if robot is None or now_s < self.next_s[robot]:
            return
        self.next_s[robot] = now_s + ALIGN_PERIOD_S
        alignment = align(own, self.others[robot], self.places.get(robot), self.trust)
        self.found[robot] = alignment
        self.is_unsaved = True
        if alignment.is_sure:
            self.places[robot] = alignment.pose
        elif robot not in self.starts:
            self.places.pop(robot, None)
        elif alignment.walls_m >= self.least_walls_m and robot in self.places:
            self.log.warning("the map of %s does not fit: %s", robot, alignment.doubt)
        header = self._header()
        self.publish(
            MapAlignment(
                header=header,
                robot=robot,
                pose=pose_stamped(self.places.get(robot, alignment.pose), header).pose,
                is_known=robot in self.starts,
                is_sure=alignment.is_sure,
                doubt=alignment.doubt,
                walls_m=alignment.walls_m,
                agreement=alignment.agreement,
                ambiguity=alignment.ambiguity,
            ),
            topic=robot,
            latched=True,
        )

    def _save(self) -> None:
        """Have a restarted process know where the other robots' maps lie, and where the robots were."""
        if not self.is_unsaved:
            return
        self.is_unsaved = False
        places = {robot: pose.tolist() for robot, pose in self.places.items()}
        trails = {robot: np.array(trail, float).reshape(-1, 2) for robot, trail in self.trails.items()}
        self.checkpoint({"places": places, "trails": trails})

    def _publish(self, own: GridMap) -> None:
        placed = [(grid, self.places[robot]) for robot, grid in self.others.items() if robot in self.places]
        team = merged(own, placed)
        for robot, place in self.places.items():
            if self.trails[robot]:
                there = transform_points(place, np.array(self.trails[robot]))
                team = without_robot(team, there, self.footprint_m, self.others.get(robot), place)
        corner = np.asarray(team.corner_xy_m, float).tolist()
        height, width = team.cells.shape
        info = MapMetaData(
            resolution=team.resolution_m,
            width=width,
            height=height,
            origin=Pose(position=Point(x=corner[0], y=corner[1])),
        )
        self.publish(
            OccupancyGrid(header=self._header(), info=info, data=team.cells.ravel()),
            topic="team",
            latched=True,
        )

    def _place(self) -> None:
        """Tell the scene graph where the other maps are."""
        header = self._header()
        transforms = []
        for robot, place in self.places.items():
            pose = pose_stamped(place, header).pose
            where = Transform(
                translation=Vector3(x=pose.position.x, y=pose.position.y), rotation=pose.orientation
            )
            transforms.append(TransformStamped(header=header, child_frame_id=f"{robot}/map", transform=where))
        if transforms:
            self.publish(TFMessage(transforms=transforms), topic="placed")

    def _described(self, robot: str) -> str:
        alignment = self.found.get(robot)
        if alignment is None:
            return f"{robot}: no map yet"
        return f"{robot}: {'sure' if alignment.is_sure else alignment.doubt}"

    def _header(self) -> Header:
        return Header(stamp=self.now(), frame_id="map")
