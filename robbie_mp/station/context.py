"""What the operator station offers to its panels. Each takes in its constructor what it uses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from robbie_mp.messages import Header, Time, TimeJump
from robbie_mp.run.plan import RunPlan
from robbie_mp.scene import SceneGraphListener
from robbie_mp.station.driving.command import RobotCommand
from robbie_mp.station.driving.motion import RobotMotion
from robbie_mp.station.driving.operators import Operators
from robbie_mp.station.floor.sight import FloorSight
from robbie_mp.station.live import LiveParts
from robbie_mp.station.map.marks import MapMarks, PlacesWatch
from robbie_mp.station.past.player import ClipPlayer
from robbie_mp.station.past.recordings import RunRecorder
from robbie_mp.station.scene_view.picture_pose import has_turned
from robbie_mp.station.watch.births import Births
from robbie_mp.station.watch.cameras import Cameras
from robbie_mp.station.watch.joints import JointsWatch
from robbie_mp.station.watch.lights import LightsWatch
from robbie_mp.station.watch.run import RunWatch
from robbie_mp.station.watch.settings import SettingsWatch
from robbie_mp.station.web.proxy import public_address

if TYPE_CHECKING:
    import logging
    from pathlib import Path

    from robbie_mp.module.clock import Clock
    from robbie_mp.run.run_directory import KnownRun
    from robbie_mp.station.fleet.robots import OtherRobots
    from robbie_mp.station.module import StationModule
    from robbie_mp.station.settings import StationSettings
    from robbie_mp.station.watch.latest import MessageSource


@dataclass(frozen=True)
class RunView:
    """The run that the station is part of."""

    known: KnownRun
    output_directory: Path
    figures: RunWatch
    """The figures of all processes and channels."""
    settings: SettingsWatch
    """The settings of all modules that can be changed."""
    player: ClipPlayer
    """Plays clips of the run."""
    recorder: RunRecorder
    """Records the run when an operator says so."""
    log_source: str = ""
    """Name of the module that plays a log in this run; '' if the run is of a live robot."""


@dataclass(frozen=True)
class RobotView:
    """What the robot does and sees."""

    scene: SceneGraphListener
    motion: RobotMotion
    """Its movement, and what it is commanded."""
    cameras: Cameras
    """Those that have sent an image."""
    lights: LightsWatch
    joints: JointsWatch
    births: Births
    """When what they saw was measured."""
    floor: FloorSight
    """Where the floor is in the cameras' pictures."""


@dataclass(frozen=True)
class MapContents:
    """What the map and the 3-D view show besides the robot."""

    marks: MapMarks
    """Marks and layers of panels."""
    places: PlacesWatch
    """Points of interest that modules publish."""


@dataclass(frozen=True)
class StationContext:
    """The operator station as its panels see it.

    The module's thread runs the constructors of panels, their `tick`s and all message handlers. The page
    server's thread runs everything else.
    """

    messages: MessageSource
    settings: StationSettings
    run: RunView
    robot: RobotView
    map: MapContents
    operators: Operators
    """The open pages, and who drives."""
    live: LiveParts
    """The parts that pages draw many times a second."""
    clock: Clock
    log: logging.Logger
    team: OtherRobots | None = None
    """The other robots; None if the link of this one does not tell them apart."""


def context_of(station: StationModule, team: OtherRobots | None) -> StationContext:
    """Return what a station offers to its panels; called in its `setup`.

    Args:
        station: the station.
        team: the other robots, if it has a team.
    """
    settings_watch = SettingsWatch(station, station.known_run.folder)
    figures = RunWatch(station.run_id)
    known, output = station.known_run, station.output_directory
    player = ClipPlayer(known.folder, output, public_address(station.public_address).path, station.log)
    recorder = RunRecorder(station.run_id, known.folder, output, station.log)
    run = RunView(known, output, figures, settings_watch, player, recorder, station.log_source)
    scene = SceneGraphListener(station, hears_time_jumps=False)
    places = PlacesWatch(station)
    operators = Operators(RobotCommand(station, station.publish))
    motion = RobotMotion(station, scene, operators.pages, station.robot_size_m, station.now_s)
    is_real = RunPlan.load(station.known_run.folder).clock.source is None
    births = Births(station.clock, station.now_s, is_real=is_real)
    floor = FloorSight(station, scene.graph, births, station.clock, operators.pages, station.map_topic)

    def forget(_jump: TimeJump) -> None:
        scene.forget()
        floor.forget()

    station.hear(TimeJump, forget)
    robot = RobotView(
        scene,
        motion,
        Cameras(station, births, partial(has_turned, scene), floor),
        LightsWatch(station),
        JointsWatch(station),
        births,
        floor,
    )
    return StationContext(
        messages=station,
        settings=station,
        run=run,
        robot=robot,
        map=MapContents(MapMarks(), places),
        operators=operators,
        live=LiveParts(),
        clock=station.clock,
        log=station.log,
        team=team,
    )


def header_of_now(clock: Clock, frame_id: str = "") -> Header:
    """Return the header of a message that is created now."""
    return Header(stamp=Time.from_nanoseconds(clock.now_ns()), frame_id=frame_id)
