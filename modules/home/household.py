"""Application control of the household robot: carries out orders by call, voice and the operator's page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from robbie_mp import (
    ActiveGoal,
    CallError,
    CallRefused,
    Goal,
    Header,
    MessageHandling,
    Request,
    SettingError,
    replace,
    setting,
)
from robbie_mp.messages import (
    AnnotateMap,
    CancelNavigation,
    LaserScan,
    MapAnnotated,
    MapAnnotations,
    PointOfInterest,
    PoseStamped,
    TaughtNames,
)
from robbie_robots.modules.devices.command_age import is_late
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.home.messages import (
    CancelOrder,
    CarryOut,
    CarryOutFeedback,
    CarryOutResult,
    Following,
    FollowOrder,
    FollowOrderTaken,
    HouseholdStatus,
    HouseholdTask,
    OrderCancelled,
    WhoIsWho,
    WhoIsWhoResult,
)
from robbie_robots.modules.manipulation.messages import (
    HandOver,
    HandStatus,
    PickUp,
    PutDown,
    StowArm,
    TableObjects,
)
from robbie_robots.modules.maps.planar_messages import planar, pose_stamped, sweep_of
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals
from robbie_robots.modules.people.messages import People
from robbie_robots.modules.people.people import PEOPLE, THINGS, reports_of
from robbie_robots.modules.sensor_deadlines import LASER_S
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.workers.home.household import HouseholdWork
from robbie_robots.workers.home.household_states import HouseholdState
from robbie_robots.workers.home.orders import OrderReader, Task, TaskOrder, WrongOrder
from robbie_robots.workers.manipulation.table_view import UNKNOWN
from robbie_robots.workers.planar_pose import wrap_angle
from robbie_robots.workers.speech.order_grammar import WrongGrammar, words_with

CarryOutGoal = ActiveGoal[CarryOut, CarryOutFeedback, CarryOutResult]
MAX_POSE_AGE_S = 1.0
"""A place is learnt only from a pose that is not older."""
SEVERAL = "several"
"""The name of spoken orders that have several tasks."""
AHEAD_RAD = 0.1
"""Beams at most this far beside the robot's heading tell how far it sees ahead."""
FOLLOWS_NOBODY = "IDLE"
OTHERS_DRIVE = {HouseholdState.FOLLOW, HouseholdState.WHO}
START_S = 20.0
"""Time after which an order of the start that the robot cannot begin is given up."""


class Household(MovingModule):
    """Serves `CarryOut`, and does what `SpokenOrder`s say, by the robot's other modules.

    It drives by `NavigateTo`, grasps by `PickUp`, `PutDown` and `HandOver`, follows by `FollowOrder`, looks
    who is where by `WhoIsWho`, and keeps the names of places by `AnnotateMap`. It speaks by `Say`, and
    publishes `HouseholdStatus`. Without an arm, or without a module that follows, it says so and does the
    rest.

    With `start_orders`, it carries these out after its start, and then ends. The order survives a restart. It
    writes `household.json` to the run's results.
    """

    period_s: float = setting(0.2, "time between decisions", minimum=0.02)
    orders: dict[str, list[str]] = setting(
        {}, "sentences of the tasks bring, put, go, learn, follow and who, as those of `SpokenOrders`"
    )
    words: dict[str, list[str]] = setting({}, "what can be said for <object> and <place>")
    places: dict[str, list[float]] = setting(
        {}, "x, y (m) and heading (rad), map frame, of places that the robot knows from the start"
    )
    doors: dict[str, list[float]] = setting(
        {}, "for places behind a door, where the robot waits for somebody to open it: x, y (m), heading (rad)"
    )
    scan_topic: str = setting("", "topic of the laser that looks ahead, if there are several; '' for any")
    tables: list[str] = setting([], "places in front of tables on which objects may be")
    start_orders: list[str] = setting([], "orders of the start, such as 'bring me the soup'")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the grammar, the places, and the orders of the start."""
        orders, words, places = settings["orders"], settings["words"], settings["places"]
        assert isinstance(orders, dict) and isinstance(words, dict) and isinstance(places, dict)
        doors = settings["doors"]
        assert isinstance(doors, dict)
        for where, those in (("places", places), ("doors", doors)):
            for name, place in those.items():
                if len(place) != 3 or not all(map(math.isfinite, place)):
                    raise SettingError(f"{name}: expected x, y (m) and heading (rad), not {place}", where)
        start = settings["start_orders"]
        assert isinstance(start, list)
        try:
            reader = OrderReader(orders, words)
            for text in start:
                reader.read(text)
        except WrongGrammar as error:
            raise SettingError(str(error), "orders") from error
        except WrongOrder as error:
            text = f"{error}; the settings 'orders' and 'words' say what can be ordered"
            raise SettingError(text, "start_orders") from error

    def setup(self) -> None:
        """Subscribe; continue the order of the process before."""
        self.reader = OrderReader(self.orders, self.words)
        self.objects = list(self.words.get("object", []))
        self.work = HouseholdWork(self.monotonic_s, self.tables, on_change=self._state_changed)
        self.work.doors = self.doors
        self.open = list(self.start_orders)
        self.active: CarryOutGoal | None = None
        self.places_errand, self.follow_errand, self.errand = Errand(self), Errand(self), Errand(self)
        self.arm_stands_out = self.follows = self.has_taught = False
        self.pose_s = -math.inf
        self.began_s = self.accepted_s = self.monotonic_s()
        self.pose: tuple[float, float, float] | None = None
        self.annotations: MapAnnotations | None = None
        self.following = ""
        self.told: HouseholdStatus | None = None
        self.fed_back = ""
        if self.restored is not None:
            self._restore(self.restored)
        self.show_state(self.work.state)
        self.goals = NavigationGoals(self, self.work.arrived, self.work.unreachable, self._see_stopped)
        self._connect()

    def _connect(self) -> None:
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.advertise(Say)
        self.serve_goals(CarryOut, self.on_order, self.on_cancel)
        self.serve(CancelOrder, self.on_cancel_order)
        self.subscribe(SpokenOrder, self.on_spoken, optional=True)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(MapAnnotations, self.on_annotations, newest)
        if self.doors:
            self.subscribe(LaserScan, self.on_scan, newest, topic=self.scan_topic, deadline_s=LASER_S)
        self.subscribe(People, self.on_people, newest, topic=PEOPLE, optional=True)
        self.subscribe(People, self.on_things, newest, topic=THINGS, optional=True)
        self.subscribe(TableObjects, self.on_table, newest, optional=True)
        self.subscribe(TaughtNames, self.on_taught, newest, topic="objects", optional=True)
        self.subscribe(HandStatus, self.on_hand, newest, optional=True)
        self.subscribe(Following, self.on_following, newest, optional=True)

    def _restore(self, kept: dict[str, Any]) -> None:
        self.open, self.accepted_s = list(kept["open"]), kept["accepted_s"]
        self.follows, self.has_taught = kept["follows"], kept["has_taught"]
        if kept["goal"] is not None:
            self.active = self.resume_goal(CarryOut, kept["goal"])
        self.work.remember(kept["work"])

    # -- orders --------------------------------------------------------------------------------------------

    def on_order(self, active: CarryOutGoal) -> None:
        """Begin an order."""
        goal = active.goal
        try:
            tasks = self.reader.read(goal.text) if goal.text else [task_order(one) for one in goal.tasks]
            self.work.begin(tasks)
        except WrongOrder as error:
            raise CallRefused(str(error)) from error
        self._replace(active, f"{active.client} has given another order")

    def on_cancel(self, active: CarryOutGoal, reason: str) -> None:
        """End the order; the robot stands where it is, and holds what it holds."""
        if active is self.active:
            self.active = None
            self.work.cancel(reason)
            self._keep()
        active.cancelled(reason)

    def on_cancel_order(self, request: CancelOrder) -> OrderCancelled:
        """End the order of anybody."""
        self.open = []
        had_order = self.work.cancel(request.reason or "was told to stop")
        if self.active is not None:
            self.active.cancelled(request.reason or "was told to stop")
            self.active = None
        self._keep()
        return OrderCancelled(had_order=had_order)

    def on_spoken(self, spoken: SpokenOrder) -> None:
        """Do what somebody has said; say why not."""
        if spoken.order == "stop":
            self._stop_all()
            return
        if spoken.order not in (*Task, SEVERAL):
            return
        if is_late(self):
            self.log.warning("ignored a late order: %s", spoken.text)
            return
        try:
            self.work.begin(self.reader.read(spoken.text))
        except WrongOrder as error:
            self.log.info('refused "%s": %s', spoken.text, error)
            self._say(f"{error}.")
            return
        self._replace(None, "somebody has spoken another order")

    def _stop_all(self) -> None:
        """End the order and every drive, also those that others have ordered."""
        says_it_itself = self.work.state in OTHERS_DRIVE
        had_order = self.on_cancel_order(CancelOrder(reason="was told to stop")).had_order
        if had_order and not says_it_itself:
            self._say("I stop.")
        self.call(CancelNavigation(reason="was told to stop"), lambda _reply: None)

    def _replace(self, active: CarryOutGoal | None, reason: str) -> None:
        """Let a new order take the place of the one before."""
        before, self.active, self.fed_back = self.active, active, ""
        self.accepted_s = self.monotonic_s()
        self._keep()
        if before is not None:
            before.preempt(reason)

    # -- what it sees --------------------------------------------------------------------------------------

    def on_pose(self, message: PoseStamped) -> None:
        """Take the robot's pose."""
        self.pose, self.pose_s = planar(message.pose), self.monotonic_s()
        self.work.see_pose(self.pose)

    def on_scan(self, scan: LaserScan) -> None:
        """Pass on how far the laser sees straight ahead."""
        sweep = sweep_of(scan)
        ahead = sweep.ranges_m[np.abs(wrap_angle(sweep.bearings_rad)) <= AHEAD_RAD]
        seen = ahead[ahead > 0.0]
        if len(seen):
            self.work.see_ahead(float(np.median(seen)))

    def on_annotations(self, annotations: MapAnnotations) -> None:
        """Know the places of the map."""
        self.annotations = annotations
        self.work.places = {one.name: planar(one.pose) for one in annotations.places}

    def on_people(self, message: People) -> None:
        """Pass on the persons."""
        self.work.see_persons(reports_of(message, self.clock.now_ns()))

    def on_things(self, message: People) -> None:
        """Pass on what may be persons who stand."""
        self.work.see_things(reports_of(message, self.clock.now_ns()))

    def on_table(self, message: TableObjects) -> None:
        """Pass on what stands on the table."""
        self.work.see_objects(one.name for one in message.objects if not one.name.startswith(UNKNOWN))

    def on_taught(self, message: TaughtNames) -> None:
        """Take orders for the objects that people have taught, too."""
        known = self.words.get("object", [])
        self.objects = [*known, *(name for name in message.names if name not in known)]
        self.reader = OrderReader(self.orders, words_with(self.words, "object", message.names))

    def on_hand(self, message: HandStatus) -> None:
        """Know that there is an arm, and what it holds."""
        self.work.see_hand(message.held)
        self.arm_stands_out = message.stands_out

    def on_following(self, message: Following) -> None:
        """Notice that the robot follows nobody any more."""
        self.following = message.state
        if self.follows and self.work.state is HouseholdState.FOLLOW and message.state == FOLLOWS_NOBODY:
            self.follows = False
            self.work.ended(message.reason == "was told to stop", message.reason)

    # -- what it does --------------------------------------------------------------------------------------

    def act(self) -> None:
        """Have the other modules do what is due."""
        work = self.work
        self._teach_places()
        if self.open and work.order is None and self.pose is not None and self.has_taught:
            self._begin_own(self.open[0])
        work.step()
        for text in work.sayings():
            self._say(text)
        self._follow()
        self._drive()
        self._have_done()
        self._tell_client()
        self._keep()
        self._tell()
        self.status = work.status
        is_over = self.start_orders and not self.open and work.order is None
        if is_over and work.machine.time_in_state_s >= 1.0:
            self.log.info("all orders have ended: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Write how the tasks ended."""
        ends = [
            {
                **end.order._asdict(),
                "is_done": end.is_done,
                "reason": end.reason,
                "duration_s": round(end.duration_s, 2),
            }
            for end in self.work.ends
        ]
        self.write_result("household.json", json.dumps(ends) + "\n")

    def _begin_own(self, text: str) -> None:
        """Begin an order of the start; what it needs may still be starting."""
        try:
            self.work.begin(self.reader.read(text))
        except WrongOrder as error:
            if self.monotonic_s() - self.began_s < START_S:
                return
            self.log.error("cannot carry out %r: %s", text, error)
        self.open.pop(0)

    # -- what other modules do -----------------------------------------------------------------------------

    def _teach_places(self) -> None:
        """Have the map take the profile's places that it lacks, once."""
        if self.has_taught or self.annotations is None:
            return
        missing = {name: place for name, place in self.places.items() if name not in self.work.places}
        if missing:
            self.places_errand.want("places", annotation(missing), self._on_known, self._on_not_known)
        else:
            self.has_taught = True

    def _on_known(self, _reply: MapAnnotated) -> None:
        self.has_taught = True

    def _on_not_known(self, error: CallError) -> None:
        self.has_taught = isinstance(error, CallRefused)

    def _follow(self) -> None:
        """Have the module that follows begin, or end, what this one or another has ordered.

        If the order ends before it has begun to follow, its reply still counts: then it is told to stop.
        """
        is_to_follow = self.work.state is HouseholdState.FOLLOW
        if is_to_follow and not self.follows:
            order = FollowOrder(order="follow")
            self.follow_errand.want("follow", order, self._on_follows, self._on_not_followed)
        elif not is_to_follow and (self.follows or self._is_led_away):
            order = FollowOrder(order="stop")
            self.follow_errand.want("stop following", order, self._on_follows_nobody, self._on_follows_nobody)

    @property
    def _is_led_away(self) -> bool:
        """Return whether the robot follows somebody though it should drive elsewhere."""
        return self.work.goal is not None and self.following not in ("", FOLLOWS_NOBODY)

    def _on_follows(self, _reply: FollowOrderTaken) -> None:
        self.follows = True

    def _on_not_followed(self, _error: CallError) -> None:
        self.work.ended(False, "I cannot follow anybody")

    def _on_follows_nobody(self, _end: FollowOrderTaken | CallError) -> None:
        """Forget that the robot follows; also if nothing is there that could."""
        self.follows, self.following = False, ""

    def _drive(self) -> None:
        """Have navigation drive to the goal, unless others drive."""
        goal, state = self.work.goal, self.work.state
        if self.pose is None:
            return
        if goal is None or self._is_led_away or self.arm_stands_out:
            self.goals.cancel(state.value if state in OTHERS_DRIVE else self.work.machine.reason)
        else:
            self.goals.drive_to(goal, self.pose)

    def _see_stopped(self, reason: str | None) -> None:
        """Show why the robot cannot drive."""
        if reason is not None:
            self.log.info("cannot drive: %s", reason)

    def _have_done(self) -> None:
        """Have the arm, or another module, do what is due."""
        what, asked = self._due()
        if asked is None or what != self.errand.wanted:
            self.errand.drop("not wanted any more")
        if asked is not None:
            self.errand.want(what, asked, partial(self._on_done, what), partial(self._on_failed, what))

    def _due(self) -> tuple[HouseholdState, Request[Any] | Goal[Any, Any] | None]:
        """Return what is due, and in which state; IDLE stands for all that have nothing else to do."""
        work, state, order = self.work, self.work.state, self.work.order
        asked: Request[Any] | Goal[Any, Any] | None = None
        if order is None:
            return state, None
        match state:
            case HouseholdState.PICK:
                asked = PickUp(object=order.object)
            case HouseholdState.PUT:
                asked = PutDown(object=work.holds)
            case HouseholdState.HAND:
                asked = HandOver(object=work.holds)
            case HouseholdState.WHO:
                asked = WhoIsWho()
            case HouseholdState.LEARN if self.monotonic_s() - self.pose_s > MAX_POSE_AGE_S:
                work.ended(False, "I do not know where I am")
            case HouseholdState.LEARN if self.pose is not None:
                asked = annotation({order.place: self.pose})
            case _ if self.arm_stands_out:  # an order that was cancelled has left the arm where it was
                return HouseholdState.IDLE, StowArm()
        return state, asked

    def _on_done(self, state: HouseholdState, end: object) -> None:
        if state is self.work.state:
            met = f"has met {len(end.persons)} persons" if isinstance(end, WhoIsWhoResult) else ""
            self.work.ended(True, met)

    def _on_failed(self, state: HouseholdState, error: CallError) -> None:
        """Give up what cannot be done; what an accident has ended is repeated."""
        if state is self.work.state:
            self.work.ended(False, str(error), is_refused=isinstance(error, CallRefused))

    # -- clients -------------------------------------------------------------------------------------------

    def _tell_client(self) -> None:
        """Tell the order's client how far the robot is, or how the order ended."""
        active, work = self.active, self.work
        if active is None:
            return
        if work.order is None:
            end = work.ends[-1]
            self.active = None
            self._keep()
            if end.is_done:
                active.succeed(CarryOutResult(duration_s=self.monotonic_s() - self.accepted_s))
            else:
                active.abort(f"could not {end.order.text}: {end.reason}")
            return
        state, reason = work.state.name, work.machine.reason
        if self.fed_back != f"{work.at} {state} {reason}":
            self.fed_back = f"{work.at} {state} {reason}"
            active.feedback(CarryOutFeedback(at=work.at, state=state, reason=reason))

    def _tell(self) -> None:
        """Publish what the robot does and knows, if that has changed."""
        work = self.work
        known = HouseholdStatus(
            state=work.state.name,
            reason=work.machine.reason,
            tasks=[
                HouseholdTask(task=str(one.task), object=one.object, place=one.place) for one in work.orders
            ],
            at=work.at,
            holds=work.holds,
            has_arm=work.has_arm,
            objects=self.objects,
            places=sorted(work.places),
            names=self.words.get("place", []),
        )
        if known != self.told:
            self.told = known
            header = Header(stamp=self.now())
            self.publish(replace(known, header=header), latched=True)

    def _say(self, text: str) -> None:
        self.log.info('says "%s"', text)
        self.publish(Say(text=text))

    def _state_changed(self, state: HouseholdState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.work.machine.reason)

    def _keep(self) -> None:
        self.checkpoint(
            {
                "work": self.work.memory(),
                "open": self.open,
                "goal": None if self.active is None else self.active.memory,
                "accepted_s": self.accepted_s,
                "follows": self.follows,
                "has_taught": self.has_taught,
            }
        )


def annotation(places: Mapping[str, Sequence[float]]) -> AnnotateMap:
    """Return the request to keep places, x, y (m) and heading (rad) in the map frame, by their names."""
    header = Header(frame_id="map")
    return AnnotateMap(
        places=[
            PointOfInterest(name=name, pose=pose_stamped(place, header).pose)
            for name, place in places.items()
        ]
    )


def task_order(message: HouseholdTask) -> TaskOrder:
    """Return the task of a message.

    Raises:
        WrongOrder: there is no such task.
    """
    if message.task not in list(Task):
        raise WrongOrder(f"there is no task {message.task!r:.80}; there are: {', '.join(Task)}")
    return TaskOrder(Task(message.task), message.object, message.place)
