"""Application control of the robot that learns persons' names, and says who is where."""

import json
import math
from typing import Any, cast

from robbie_mp import ActiveGoal, CallError, CallRefused, MessageHandling, Time, setting
from robbie_mp.messages import (
    CameraInfo,
    Detection2D,
    Detection2DArray,
    Image,
    MapAnnotations,
    OccupancyGrid,
    Point,
    PoseStamped,
    RecognitionTaught,
    TaughtNames,
    TeachRecognition,
)
from robbie_mp.scene import RigidTransform, SceneGraphError, SceneGraphListener, TooNew
from robbie_robots.modules.devices.camera_turn import CameraTurn
from robbie_robots.modules.devices.command_age import is_late
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.home.messages import (
    Following,
    LearnPerson,
    LearnPersonFeedback,
    LearnPersonResult,
    MetPerson,
    WhoIsWho,
    WhoIsWhoFeedback,
    WhoIsWhoResult,
)
from robbie_robots.modules.maps.planar_messages import map_cells, planar
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals
from robbie_robots.modules.people.messages import People
from robbie_robots.modules.people.people import PEOPLE, THINGS, reports_of
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.modules.taught_recognition import TaughtFaces
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.follow_states import FollowState
from robbie_robots.workers.home.person_places import Eye, SeenFace
from robbie_robots.workers.home.person_tour import Met, PersonTour, TourState
from robbie_robots.workers.taught import TeachingError, checked_name

ActiveRound = ActiveGoal[WhoIsWho, WhoIsWhoFeedback, WhoIsWhoResult]
ActiveLesson = ActiveGoal[LearnPerson, LearnPersonFeedback, LearnPersonResult]
PERSONS = TaughtFaces.kind
FACE_M = 1.55
"""Height of a face above the floor; the camera has to see those of taller and smaller persons, too."""
FACE_WIDTH_M = 0.15
"""Width of the box around a face: 0.12 to 0.19 m for the real faces of `tools.trials.missions.who_is_who`."""
TURN_RAD = 0.04
LESSON_S = 5.0
MAX_PICTURES = 8
"""Pictures that wait for what is found in them."""

CANNOT = "I cannot recognize faces."
LOOK_AT_ME = "Please look at me."
STOPPED = "I stop looking for persons."


class WhoIsWhoTask(MovingModule):
    """Serves `LearnPerson` and `WhoIsWho`, and takes both as `SpokenOrder`.

    The spoken orders are `name`, with the slot `name` ("my name is Anna"), `who` and `stop`. The module
    finds persons as `FollowMe` does, and drives by `NavigateTo`. `TaughtFaces` recognizes and learns the
    faces; without it, orders are refused. It speaks by `Say`, and writes `who_is_who.json`. An order survives
    a restart.
    """

    camera: str = setting("camera", "topic of the images that are searched for faces")
    period_s: float = setting(0.1, "time between decisions", minimum=0.02)

    def setup(self) -> None:
        """Create the task; subscribe to persons, faces, map and pose; continue an order."""
        self.tour = PersonTour(self.monotonic_s, on_change=self._state_changed)
        self.active: ActiveRound | ActiveLesson | None = None
        self.names: list[str] | None = None
        self.places: list[tuple[str, tuple[float, float]]] = []
        self.pose: tuple[float, float, float] | None = None
        self.pose_stamp = Time()
        self.intrinsics: tuple[float, float] | None = None
        self.pictures: dict[int, Image] = {}
        self.found: Detection2DArray | None = None
        self.things: list[PersonReport] = []
        self.camera_turn = CameraTurn(self, TURN_RAD)
        self.follows = False
        self.lesson = Errand(self, timeout_s=LESSON_S, topic=PERSONS)
        self.fed_back = ""
        self.done = self.failed = self.examples = 0
        if self.restored is not None:
            self._restore(self.restored)
        self.show_state(self.tour.state)
        self.goals = NavigationGoals(self, self.tour.arrived, self.tour.unreachable, lambda _reason: None)
        self.scene = SceneGraphListener(self)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.advertise(Say)
        self.serve_goals(WhoIsWho, self.on_who, self.on_cancel)
        self.serve_goals(LearnPerson, self.on_learn, self.on_cancel)
        self.subscribe(SpokenOrder, self.on_order, optional=True)
        self.subscribe(Following, self.on_following, newest, optional=True)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(OccupancyGrid, self.on_map, newest, optional=True)
        self.subscribe(MapAnnotations, self.on_annotations, newest, optional=True)
        self.subscribe(People, self.on_people, newest, topic=PEOPLE)
        self.subscribe(People, self.on_things, newest, topic=THINGS, optional=True)
        self.subscribe(TaughtNames, self.on_names, newest, topic=PERSONS, optional=True)
        self.subscribe(CameraInfo, self.on_camera, newest, topic=self.camera, optional=True)
        self.subscribe(Image, self.on_image, newest, topic=self.camera, optional=True)
        self.subscribe(Detection2DArray, self.on_faces, newest, topic=self.camera, optional=True)

    def _restore(self, kept: dict[str, Any]) -> None:
        self.tour.remember(kept["tour"])
        self.done, self.failed = kept["done"], kept["failed"]
        if kept["goal"] is not None and self.tour.learns:
            self.active = self.resume_goal(LearnPerson, kept["goal"])
        elif kept["goal"] is not None:
            self.active = self.resume_goal(WhoIsWho, kept["goal"])

    # -- orders ----------------------------------------------------------------------------------------

    def on_who(self, active: ActiveRound) -> None:
        """Begin a round, or take over the one that is under way."""
        if self.tour.state is TourState.IDLE:
            self._check()
            self.tour.go_round(active.goal.persons)
        elif self.tour.learns:
            raise CallRefused(f"the robot learns {self.tour.learns}: ask again when it has done so")
        self._serve(active)

    def on_learn(self, active: ActiveLesson) -> None:
        """Begin to learn a person."""
        try:
            name = checked_name(active.goal.name)
        except TeachingError as error:
            raise CallRefused(str(error)) from error
        self._check()
        if self.tour.state is not TourState.IDLE:
            raise CallRefused("the robot has another order: cancel it, or wait")
        self.tour.learn(name)
        self._serve(active)

    def on_order(self, order: SpokenOrder) -> None:
        """Do what somebody has said, if it concerns this task."""
        if order.order != "stop" and is_late(self):
            self.log.warning("ignored a late order: %s", order.text)
            return
        name = next((slot.words for slot in order.slots if slot.name == "name"), "")
        is_idle = self.tour.state is TourState.IDLE
        if order.order == "stop" and not is_idle:
            self._cancel("was told to stop")
            self._say(STOPPED)
        elif is_idle and (order.order == "who" or (order.order == "name" and name)):
            try:
                self._check()
                name = checked_name(name) if order.order == "name" else ""
            except (CallRefused, TeachingError) as error:
                self.log.warning("%s: %s", order.text, error)
                return
            if name:
                self.tour.learn(name)
            else:
                self.tour.go_round(0)
            self._keep()

    def on_cancel(self, active: ActiveRound | ActiveLesson, reason: str) -> None:
        """End the order; the robot stands."""
        if active is self.active:
            self._cancel(reason)
        else:
            active.cancelled(reason)

    def _check(self) -> None:
        """Raise CallRefused if the robot cannot do it now."""
        if self.names is None:
            self._say(CANNOT)
            raise CallRefused(
                "no module recognizes faces: install the extra 'faces', and use the profile home-faces or "
                "add robbie_robots.modules.taught_recognition:TaughtFaces"
            )
        if self.follows:
            raise CallRefused("the robot follows a person: tell it to stop first")

    def _serve(self, active: ActiveRound | ActiveLesson) -> None:
        if self.active is not None and self.active.is_active:
            self.active.cancelled("a newer goal has taken over")
        self.active, self.fed_back = active, ""
        self._keep()

    def _cancel(self, reason: str) -> None:
        active, self.active = self.active, None
        self.tour.cancel(reason)
        self.tour.end = None
        if active is not None and active.is_active:
            active.cancelled(reason)
        self._keep()

    # -- inputs ----------------------------------------------------------------------------------------

    def on_following(self, message: Following) -> None:
        """Note whether the robot follows somebody; two tasks must not drive at the same time."""
        self.follows = message.state not in ("", FollowState.IDLE.name)
        if self.follows and self.tour.state is not TourState.IDLE:
            self._cancel("the robot follows a person now")

    def on_pose(self, message: PoseStamped) -> None:
        """Take the robot's pose."""
        self.pose, self.pose_stamp = planar(message.pose), message.header.stamp
        self.tour.see_pose(self.pose)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Pass on the map, which is searched."""
        self.tour.see_map(*map_cells(grid))

    def on_annotations(self, message: MapAnnotations) -> None:
        """Take the names of places."""
        self.places = [(one.name, planar(one.pose)[:2]) for one in message.places]

    def on_people(self, message: People) -> None:
        """Pass on the persons."""
        persons = reports_of(message, self.clock.now_ns())
        names = {one.name for one in persons}
        self.tour.see_persons([*persons, *(one for one in self.things if one.name not in names)])

    def on_things(self, message: People) -> None:
        """Keep what may be a person or a thing on the map, until the next persons."""
        self.things = reports_of(message, self.clock.now_ns())

    def on_names(self, message: TaughtNames) -> None:
        """Note the names of known persons."""
        self.names = list(message.names)

    def on_camera(self, camera: CameraInfo) -> None:
        """Take the camera's projection."""
        if camera.is_calibrated:
            self.intrinsics = float(camera.k[0]), float(camera.k[2])

    def on_image(self, image: Image) -> None:
        """Keep a picture while somebody is learnt: what is found in it comes later."""
        if self.tour.learns and self.tour.state is not TourState.IDLE:
            self.pictures[image.header.stamp.nanoseconds] = image
            while len(self.pictures) > MAX_PICTURES:
                del self.pictures[min(self.pictures)]

    def on_faces(self, message: Detection2DArray) -> None:
        """Keep the faces until the camera's pose at their stamp is known."""
        self.found = message

    # -- decisions -------------------------------------------------------------------------------------

    def act(self) -> None:
        """Let the task decide; send goals, directions, faces and words to other modules."""
        self._see_faces()
        tour = self.tour
        orders = tour.step()
        if tour.end is not None:
            self._finish()
        if tour.state is TourState.IDLE:
            self.pictures.clear()
            self.goals.cancel(tour.machine.reason)
        elif self.pose is not None:
            self.goals.drive_to(orders.goal, self.pose)
            self._turn_camera(orders.look_at_xy_m)
        self._teach(tour.to_learn)
        self._tell_client()
        self._keep()
        known = "no faces" if self.names is None else f"knows {len(self.names)} persons"
        self.status = (
            f"{tour.state} ({tour.machine.reason}); has met {len(tour.met)}, {known}; "
            f"{self.done} orders done, {self.failed} failed"
        )

    def teardown(self) -> None:
        """Write which persons were met last."""
        persons = [
            {"name": one.name, "x_m": one.xy_m[0], "y_m": one.xy_m[1], "faces": one.faces}
            for one in self.tour.met
        ]
        counted = {"done": self.done, "failed": self.failed, "persons": persons}
        self.write_result("who_is_who.json", json.dumps(counted) + "\n")

    def _see_faces(self) -> None:
        """Pass on the newest faces with their directions, as soon as the camera's pose is known."""
        found = self.found
        if found is None or self.intrinsics is None or self.tour.state is TourState.IDLE:
            self.found = None
            return
        stamp_ns = found.header.stamp.nanoseconds
        try:
            X_MC = self.scene.pose("map", found.header.frame_id, stamp_ns)
        except TooNew:
            return
        except SceneGraphError as error:
            self.log.debug("could not place faces: %s", error)
            self.found = None
            return
        self.found = None
        faces = [self._seen_face(stamp_ns, one, X_MC) for one in found.detections if self._is_face(one)]
        if found.detections and not faces:
            return  # of another module, which does not look for faces
        x, y, _ = X_MC.apply((0.0, 0.0, 1.0)) - X_MC.translation
        focal_px, centre_px = self.intrinsics
        self.tour.see_faces(faces, Eye(X_MC.x, X_MC.y, math.atan2(y, x), math.atan2(centre_px, focal_px)))

    def _seen_face(self, stamp_ns: int, face: Detection2D, X_MC: RigidTransform) -> SeenFace:
        assert self.intrinsics is not None
        focal_px, centre_px = self.intrinsics
        aside = (face.bbox.center.position.x - centre_px) / focal_px
        x, y, _ = X_MC.apply((aside, 0.0, 1.0)) - X_MC.translation
        name = face.results[0].hypothesis.class_id if face.results else ""
        away_m = FACE_WIDTH_M * focal_px / face.bbox.size_x if face.bbox.size_x > 0 else math.nan
        return SeenFace(name, math.atan2(y, x), (stamp_ns, face.bbox), away_m)

    def _is_face(self, one: Detection2D) -> bool:
        """Return whether a detection is a face: other modules find other things in the same pictures."""
        return one.id == TaughtFaces.unknown or one.id in (self.names or ())

    def _teach(self, face: SeenFace | None) -> None:
        """Have a face learnt."""
        if face is None:
            self.lesson.forget()
            return
        stamp_ns, box = face.key
        image = self.pictures.get(stamp_ns)
        if image is None:
            self.tour.not_learnt("the picture of the face is too old")
            return
        request = TeachRecognition(name=self.tour.learns, image=image, box=box, image_topic=self.camera)
        self.lesson.want(f"face at {stamp_ns} ns", request, self._on_taught, self._on_not_taught)

    def _on_taught(self, reply: RecognitionTaught) -> None:
        self.examples = reply.examples
        self.tour.learnt()

    def _on_not_taught(self, error: CallError) -> None:
        self.tour.not_learnt(str(error))

    def _turn_camera(self, look_at_xy_m: tuple[float, float] | None) -> None:
        """Turn the camera to a face, or straight ahead."""
        assert self.pose is not None
        pan_rad = tilt_rad = 0.0
        if look_at_xy_m is not None:
            away_m = math.dist(look_at_xy_m, self.pose[:2])
            bearing = math.atan2(look_at_xy_m[1] - self.pose[1], look_at_xy_m[0] - self.pose[0])
            pan_rad = math.remainder(bearing - self.pose[2], math.tau)
            tilt_rad = -math.atan2(FACE_M - self._eye_m(), max(away_m, 0.3))
        self.camera_turn.to(pan_rad, tilt_rad, self.pose_stamp)

    def _eye_m(self) -> float:
        """Return the height of the camera."""
        try:
            return float(self.scene.pose("base_link", f"{self.camera}_optical").translation[2])
        except SceneGraphError:
            return FACE_M

    # -- ends ------------------------------------------------------------------------------------------

    def _finish(self) -> None:
        """Say and tell how an order ended."""
        tour, active = self.tour, self.active
        assert tour.end is not None
        end, tour.end, self.active = tour.end, None, None
        self.done += end.is_done
        self.failed += not end.is_done
        self.log.info("the order ends: %s", end.reason)
        if tour.learns:
            self._say(f"Hello {tour.learns}." if end.is_done else f"I could not learn it: {end.reason}.")
        else:
            for text in self._told() or ["I have met nobody."]:
                self._say(text)
        if active is None or not active.is_active:
            return
        if not end.is_done:
            active.abort(end.reason)
        elif tour.learns:
            cast(ActiveLesson, active).succeed(LearnPersonResult(examples=self.examples))
        else:
            result = WhoIsWhoResult(persons=self._met(), duration_s=end.duration_s)
            cast(ActiveRound, active).succeed(result)

    def _told(self) -> list[str]:
        """Return who is where, in words."""
        return [f"{one.name or 'Somebody I do not know'} is {self._where(one)}." for one in self.tour.met]

    def _where(self, one: Met) -> str:
        place = self._place_of(one)
        return f"at the {place}" if place else f"at {one.xy_m[0]:.1f}, {one.xy_m[1]:.1f}"

    def _place_of(self, one: Met) -> str:
        """Return the name of the nearest place; '' if there is none."""
        return min(((math.dist(xy, one.xy_m), name) for name, xy in self.places), default=(0.0, ""))[1]

    def _met(self) -> list[MetPerson]:
        return [
            MetPerson(
                name=one.name,
                position=Point(x=one.xy_m[0], y=one.xy_m[1]),
                place=self._place_of(one),
                faces=one.faces,
            )
            for one in self.tour.met
        ]

    def _tell_client(self) -> None:
        """Tell the order's client what the robot does."""
        machine = self.tour.machine
        if self.active is None or self.fed_back == machine.state.name + machine.reason:
            return
        self.fed_back = machine.state.name + machine.reason
        state, reason = machine.state.name, machine.reason
        if self.tour.learns:
            cast(ActiveLesson, self.active).feedback(LearnPersonFeedback(state=state, reason=reason))
        else:
            feedback = WhoIsWhoFeedback(state=state, reason=reason, met=len(self.tour.met))
            cast(ActiveRound, self.active).feedback(feedback)

    def _state_changed(self, state: TourState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.tour.machine.reason)
        if state is TourState.LOOK:
            self._say(LOOK_AT_ME)

    def _keep(self) -> None:
        self.checkpoint(
            {
                "tour": self.tour.memory(),
                "goal": None if self.active is None else self.active.memory,
                "done": self.done,
                "failed": self.failed,
            }
        )

    def _say(self, text: str) -> None:
        self.log.info('says "%s"', text)
        self.publish(Say(text=text))
