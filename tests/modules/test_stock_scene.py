"""The stock robot's scene graph agrees with the frames of its devices."""

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robbie_mp import ModuleHarness
from robbie_mp.messages import Odometry, PanTiltCommand, PoseStamped
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.scene import SceneGraph, read_scene
from robbie_mp.scene.module import SceneGraphService
from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pan_tilt import PanTiltLimits
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.camera import SimulatedHeadCameraModule, SimulatedRearCameraModule
from robbie_robots.modules.devices.pan_tilt import SimulatedPanTiltModule
from tests._support.places import ARENAS, PROJECT

HW = Path(__file__).parents[2] / "hw"
SCENE = HW / "robots" / "rescue.yaml"


def test_devices_are_mounted_and_turn_as_in_the_scene_graph() -> None:
    graph = SceneGraph(read_scene(SCENE))
    camera, laser, limits = CameraGeometry(), LaserGeometry(), PanTiltLimits()
    for joint in ("pan", "tilt"):
        graph.set_joint(joint, 0, 0.0)
    assert graph.pose("base_link", "camera_optical").translation == pytest.approx(camera.mount_m)
    place = graph.pose("base_link", "laser")
    assert (place.x, place.y, place.yaw) == laser.mount
    assert graph.joint("pan").limits == (-limits.pan_rad, limits.pan_rad)
    assert graph.joint("tilt").limits == (-limits.tilt_up_rad, limits.tilt_down_rad)


def test_head_camera_of_the_household_robot_is_mounted_as_in_its_scene_graph() -> None:
    graph = SceneGraph(read_scene(HW / "robots" / "home.yaml"))
    for joint in ("pan", "tilt"):
        graph.set_joint(joint, 0, 0.0)
    place = graph.pose("base_link", "camera_optical")
    assert place.translation == pytest.approx(SimulatedHeadCameraModule.mount_m)


@pytest.mark.parametrize(("module", "frame"), [("laser", "laser"), ("rear_laser", "rear_laser")])
def test_lasers_of_the_household_robot_are_mounted_as_in_its_scene_graph(module: str, frame: str) -> None:
    settings = laser_settings()[module]
    place = SceneGraph(read_scene(HW / "robots" / "home.yaml")).pose("base_link", frame)
    assert settings.get("frame_id", "laser") == frame
    mount = settings.get("mount", [0.0, 0.0, 0.0])
    assert [place.x, place.y, place.yaw] == pytest.approx(mount, abs=1e-6)


def test_lasers_of_the_household_robot_see_all_around_its_body() -> None:
    around = np.linspace(-math.pi, math.pi, 721)
    edge = 0.2001 * np.column_stack([np.cos(around), np.sin(around)])
    seen = np.zeros((2, len(edge)), np.bool_)
    for number, settings in enumerate(laser_settings().values()):
        x_m, y_m, heading_rad = settings.get("mount", [0.0, 0.0, 0.0])
        bearings = np.arctan2(edge[:, 1] - y_m, edge[:, 0] - x_m) - heading_rad
        beam = ((bearings - settings["angle_min_rad"]) % math.tau) / settings["angle_increment_rad"]
        seen[number] = beam <= settings["steps"] - 1
    assert (seen[0] | seen[1]).all()
    assert not seen[0].all() and not seen[1].all()


def laser_settings() -> dict[str, dict[str, Any]]:
    """Return the settings of the lasers in the household robot's profile."""
    modules = yaml.safe_load((PROJECT / "profiles" / "home.yaml").read_text())["modules"]
    return {name: modules[name]["settings"] for name in ("laser", "rear_laser")}


def test_rear_camera_looks_back_and_down_as_in_the_scene_graph() -> None:
    graph = SceneGraph(read_scene(SCENE))
    place = graph.pose("base_link", "rear_camera_optical")
    assert place.translation == pytest.approx(SimulatedRearCameraModule.mount_m)
    down_rad = SimulatedRearCameraModule.tilt_rad
    ahead = place.apply([0.0, 0.0, 1.0]) - place.translation
    assert ahead == pytest.approx([-math.cos(down_rad), 0.0, -math.sin(down_rad)], abs=1e-4)
    right = place.apply([1.0, 0.0, 0.0]) - place.translation
    assert right == pytest.approx([0.0, 1.0, 0.0], abs=1e-4)


def test_messages_of_the_stock_modules_move_the_scene_graph() -> None:
    with (
        ModuleHarness(SceneGraphService, {"file": str(SCENE)}) as scene,
        ModuleHarness(SimulatedBase, {"arena": str(ARENAS / "demo.yaml")}) as base,
        ModuleHarness(SimulatedPanTiltModule) as pan_tilt,
    ):
        pan_tilt.send(PanTiltCommand(pan_rad=0.5, tilt_rad=0.25))
        pan_tilt.advance(5.0)
        base.advance(5.0)
        truth = base.take(Odometry, "ground_truth")[-1]
        for message, topic in (*base.published, *pan_tilt.published):
            with suppress(NotSubscribed):  # the scene graph takes some of them
                scene.send(message, topic=topic)
        scene.send(PoseStamped(header=truth.header), topic="map_pose")
        # What the camera looks at, 1 m ahead: to the left, and below the horizon.
        ahead = scene.module.graph.pose("base_link", "camera_optical").apply([0.0, 0.0, 1.0])
        level = math.cos(0.25)
        expected = [0.1 + level * math.cos(0.5), level * math.sin(0.5), 0.35 - math.sin(0.25)]
        assert ahead == pytest.approx(expected)
        assert scene.module.graph.pose("map", "base_link").x == pytest.approx(0.0)
        assert scene.module.warnings.ignored == 0
