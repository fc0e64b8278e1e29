"""How panels process their data: the trace, messages as trees, goals and paths."""

import math
from collections import deque
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest

from robbie_mp.attached.views.message_text import FieldPath
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import (
    Costmap,
    CostmapMetaData,
    LaserScan,
    MappingState,
    Path,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    replace,
)
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.stock.nav2_msgs import Cost
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.station.map.goals import checked
from robbie_mp.station.map.way import way_points
from robbie_mp.station.page.page import Page
from robbie_mp.station.panels import messages, plots
from robbie_mp.station.panels.map import MAX_PATH_POINTS, cost_cells, doubt_mark, doubts
from robbie_mp.station.panels.trace import SHOWN, Filter, line_of, newest
from robbie_mp.station.watch.topic import nodes_of


def entry(number: int, kind: Kind = Kind.INFO, module: str = "laser", text: str = "spins") -> Entry:
    return Entry(number, 0.25, kind, module, 1, "log", text)


def test_filter_is_by_kind_module_and_text() -> None:
    entries = deque([entry(1), entry(2, Kind.ERROR), entry(3, module="base"), entry(4, text="STOPS")])

    def numbers(kinds: list[str], module: str = "", text: str = "") -> list[int]:
        return [one.number for one in newest(entries, Filter(kinds, module, text), 0)]

    assert numbers(["info", "error"]) == [1, 2, 3, 4]
    assert numbers(["error"]) == [2]
    assert numbers(["info"], module="laser") == [1, 4]
    assert numbers(["info"], text="stops") == [4]
    assert numbers([]) == []


def test_page_gets_new_entries_and_at_most_as_many_as_it_shows() -> None:
    entries = deque(entry(number) for number in range(1, 10 * SHOWN))
    everything = Filter(["info"], "", "")
    last = entries[-1].number
    assert [one.number for one in newest(entries, everything, last - 2)] == [last - 1, last]
    assert len(newest(entries, everything, 0)) == SHOWN
    assert line_of(entries[0]).endswith(".250Z laser#1 info spins")


def test_message_is_a_tree_whose_long_arrays_are_abbreviated() -> None:
    scan = LaserScan(ranges=np.arange(100, dtype=np.float32), angle_min=-0.5)
    nodes = {node["id"]: node for node in nodes_of(FieldPath(LaserScan, "").value(scan, full=False), "")}
    assert nodes["angle_min"]["label"] == "angle_min: -0.5"
    assert [node["id"] for node in nodes["header"]["children"]] == ["header.stamp", "header.frame_id"]
    ranges = nodes["ranges"]
    assert ranges["label"] == "ranges: 100 elements"
    assert [node["label"] for node in ranges["children"][-2:]] == ["…: 92 more", "[99]: 99.0"]
    assert len({node["id"] for node in ranges["children"]}) == 9


def test_page_that_is_opened_later_shows_the_same_plots_and_unused_ones_are_bounded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(plots, "types_of_run", lambda _run: KnownTypes())
    panel = plots.PlotsPanel(Mock())
    names = [f"scan {number}" for number in range(2 * plots.MAX_KEPT)]
    channel = ChannelName(LaserScan.type_name, LaserScan.version, "")
    monkeypatch.setattr(panel, "channels", lambda: dict.fromkeys(names, channel))
    shown = panel.take((names[0], "angle_min"))
    assert panel.take((names[0], "angle_min")) is shown
    for _ in range(2):
        panel.give_back(shown)
    assert panel.take((names[0], "angle_min")) is shown, "its values are still there"
    for name in names[1:]:
        panel.give_back(panel.take((name, "angle_min")))
    assert panel.take((names[0], "angle_min")) is shown
    assert panel.take((names[-1], "angle_min")).pages == 1
    assert len(panel._lines) == 1 + plots.MAX_KEPT


WISHES = KnownTypes(
    [
        TypeDescription("zoo_msgs/msg/Wish", 1, "float64 weight\n"),
        TypeDescription("zoo_msgs/msg/Wish", 2, "float64 mass_kg\n"),
    ]
)


def published(version: int) -> Mock:
    """What a run says whose module publishes a version of a type."""
    channel = Mock(type_name="zoo_msgs/msg/Wish", version=version, topic="wishes", messages=3)
    return Mock(reading=Mock(channels=[channel]))


@pytest.mark.parametrize(("version", "field"), [(1, "weight"), (2, "mass_kg")])
def test_plots_and_form_take_the_version_that_is_published(
    monkeypatch: pytest.MonkeyPatch, version: int, field: str
) -> None:
    for module in (plots, messages):
        monkeypatch.setattr(module, "types_of_run", lambda _run: WISHES)
    station = MagicMock()
    station.run.figures = published(version)
    line = plots.PlotsPanel(station).take(("wishes: zoo_msgs/Wish", field))
    assert (line.message_type.type_name, line.message_type.version) == ("zoo_msgs/msg/Wish", version)
    panel = messages.MessagesPanel(station)
    assert panel.version_of("zoo_msgs/msg/Wish", "wishes") == version
    assert panel.version_of("zoo_msgs/msg/Wish", "elsewhere") is None


@pytest.mark.parametrize(
    "sent",
    [
        None,
        {},
        {"what": "cmd_vel", "x_m": 0, "y_m": 0, "yaw_rad": 0},
        {"what": "", "x_m": 0, "y_m": 0, "yaw_rad": 0},
        {"what": ["goal"], "x_m": 0, "y_m": 0, "yaw_rad": 0},
        {"what": "goal", "x_m": "here", "y_m": 0, "yaw_rad": 0},
        {"what": "goal", "x_m": float("nan"), "y_m": 0, "yaw_rad": None},
    ],
)
def test_malformed_goals_are_ignored(sent: object) -> None:
    assert checked(sent) is None


def test_long_path_is_thinned_but_keeps_its_end() -> None:
    path = Path(poses=[PoseStamped(pose=Pose(position=Point(x=x))) for x in range(10 * MAX_PATH_POINTS)])
    points = way_points(path, MAX_PATH_POINTS)
    assert len(points) <= MAX_PATH_POINTS + 1
    assert (points[0], points[-1]) == ([0.0, 0.0], [10.0 * MAX_PATH_POINTS - 1, 0.0])
    assert way_points(Path(), MAX_PATH_POINTS) == []


def test_doubts_about_the_map_are_drawn_as_an_ellipse_and_said_in_words() -> None:
    covariance = np.array([[0.04, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.01]]).ravel()
    known = MappingState(certain=True, spread_m=1.02, spread_rad=0.1, covariance=covariance)
    half, other_half, direction = doubt_mark(known) or [0.0] * 3
    assert (half, other_half) == pytest.approx((2.45, 0.49), abs=0.01)
    assert abs(direction) == pytest.approx(math.pi / 2, abs=0.01)
    assert doubts(known) == ["position ± 1.02 m, heading ± 5.7°"]
    lost = replace(known, certain=False, gaps_open=2, share_beyond_gaps=0.4)
    assert doubts(lost)[1:] == [
        "LOST: what the laser sees does not fit the map",
        "2 gaps are open: only odometry joins 40% of the map to its beginning",
    ]
    assert (doubt_mark(None), doubts(None)) == (None, [])


def test_costmap_is_drawn_as_cells_and_one_of_a_wrong_size_is_not() -> None:
    metadata = CostmapMetaData(resolution=0.5, size_x=3, size_y=2, origin=Pose(position=Point(x=-1.0, y=2.0)))
    costs = np.array([0, 252, 253, 254, 255, 1], np.uint8)
    newest = Mock(message=Costmap(metadata=metadata, data=costs), count=7)
    avoided = cost_cells(newest, 1, Cost.AVOIDED)
    assert (avoided.revision, avoided.edge_m) == (7, 0.5)
    assert avoided.middles.tolist() == [[-0.25, 2.25], [0.25, 2.75]]
    assert cost_cells(newest, Cost.OBSTACLE, Cost.OBSTACLE).middles.tolist() == [[-0.75, 2.75]]
    newest.message = Costmap(metadata=metadata, data=costs[:5])
    assert len(cost_cells(newest, 1, Cost.AVOIDED).middles) == 0


def test_turned_costmap_is_drawn_where_it_lies() -> None:
    origin = Pose(position=Point(x=-1.0, y=2.0), orientation=Quaternion.from_yaw(math.pi / 2))
    metadata = CostmapMetaData(resolution=0.5, size_x=3, size_y=1, origin=origin)
    newest = Mock(message=Costmap(metadata=metadata, data=np.array([0, 0, 252], np.uint8)), count=7)
    assert cost_cells(newest, 1, Cost.AVOIDED).middles[0] == pytest.approx([-1.25, 3.25])


def test_goal_without_a_heading_has_none() -> None:
    assert checked({"what": "goal", "x_m": 1, "y_m": 2.5, "yaw_rad": None}) == ("goal", 1.0, 2.5, None)


def test_panel_is_updated_only_while_the_page_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    timers: list[Mock] = []

    def timer(_period_s: float, _update: object) -> Mock:
        timers.append(Mock(active=True))
        return timers[-1]

    monkeypatch.setattr("nicegui.ui.timer", timer)
    page = Page("key", "session", Mock(), Mock(), Mock())
    page.every(0.1, "map", Mock())
    page.every(0.1, "view", Mock())
    page.always(0.1, Mock())

    def running() -> list[bool]:
        return [one.active for one in timers]

    assert running() == [False, False, True]
    page.show(frozenset({"view"}))
    assert running() == [False, True, True]
    page.show(frozenset({"map"}))
    assert running() == [True, False, True]
