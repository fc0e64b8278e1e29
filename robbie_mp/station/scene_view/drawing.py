"""Creates the objects of one page's 3-D view. The page's own script moves them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.scene.scene_object3d import Object3D

from robbie_mp.station.live import SCRIPTS
from robbie_mp.station.map.marks import MapMark, MarkPicture
from robbie_mp.station.scene_view.surroundings import BASE, SceneContents, SeenPlace

POLE_M = 0.6
PICTURE_M = 0.4
"""Width of a mark's picture."""
OVER_MARK_M = 0.15
LABEL = "color: var(--text); background: var(--tile); padding: 0 .3em; border-radius: 3px; font-size: .75rem"
"""Style of names: colours of the page's look that have enough contrast whatever is drawn behind them."""


class Moving(Element, component="moving.js", esm=SCRIPTS):
    """Holds a scene, moves its nodes with the robot, and draws points, path and map."""

    def __init__(self) -> None:
        super().__init__()
        self.set(follows=True)

    def move_in(self, scene: ui.scene) -> None:
        """Set the scene."""
        self.set(scene=scene.id)

    def set(self, **properties: object) -> None:
        """Change properties of the page's script.

        Args:
            properties: `follows`: whether the camera moves with the robot; `walls`: whether walls are raised
                from the map; `colours`: of points; `placing`: what a click on the floor places.
        """
        self._props.update(properties)
        self.update()


class SceneDrawing:
    """Draws surroundings in a scene, and updates only changed objects.

    Args:
        scene: the scene.
        robot_size_m: length, width and height of the robot's body.
        model_url: address of a model of the robot; '': draw a box.
    """

    def __init__(self, scene: ui.scene, robot_size_m: Sequence[float], model_url: str = ""):
        self._scene = scene
        self._size_m = robot_size_m
        self._model_url = model_url
        self._world = ""
        self._nodes: dict[str, Object3D] = {}
        self._parents: dict[str, str] = {}
        self._labels: dict[str, Sequence[Object3D]] = {}
        self._marks: dict[MapMark, Object3D] = {}
        self._places: dict[SeenPlace, Object3D] = {}

    def show(self, now: SceneContents, *, names: bool) -> None:
        """Draw the surroundings, with names and axes of the frames if they are wanted."""
        is_other_tree = any(now.nodes.get(name, ("",))[0] != was for name, was in self._parents.items())
        if is_other_tree or now.world != self._world:
            self._begin_anew(now.world)
        for name, (parent, _) in now.nodes.items():
            if name not in self._nodes:
                self._add(name, parent)
            for label in self._labels[name]:
                label.visible(names)
        marks = {mark for marks in now.marks.values() for mark in marks}
        for mark in self._marks.keys() - marks:
            self._marks.pop(mark).delete()
        for mark in marks - self._marks.keys():
            self._marks[mark] = self._marker(mark)
        for place in self._places.keys() - set(now.places):
            self._places.pop(place).delete()
        for place in now.places:
            if place not in self._places:
                self._places[place] = self._flag(place)

    def _begin_anew(self, world: str) -> None:
        for name, parent in self._parents.items():
            if parent == self._world:
                self._nodes[name].delete()  # with its whole subtree
        self._nodes, self._parents, self._labels = {}, {}, {}
        self._world = world

    def _add(self, name: str, parent: str) -> None:
        with self._scene, self._nodes.get(parent) or nullcontext():
            node = ui.scene.group().with_name(name)
            with node:
                self._body(name)
                self._labels[name] = (ui.scene.axes_helper(0.25), ui.scene.text(name, LABEL))
        self._nodes[name], self._parents[name] = node, parent

    def _body(self, name: str) -> None:
        """Draw the object at a node, if the node's name determines one."""
        robot, _, kind = name.rpartition("/")
        if kind == BASE:
            self._robot()
            if robot:
                ui.scene.text(robot, LABEL).move(z=self._size_m[2] + 0.2)
        elif "laser" in kind:
            ui.scene.cylinder(0.05, 0.05, 0.07).rotate(1.5708, 0, 0).material("#263238")
        elif kind.endswith("optical"):
            ui.scene.box(0.1, 0.06, 0.05).material("#1565c0")

    def _robot(self) -> None:
        if self._model_url:
            if self._model_url.endswith(".stl"):
                ui.scene.stl(self._model_url).material("#ffb300")
            else:
                ui.scene.gltf(self._model_url)
            return
        length, width, height = self._size_m
        ui.scene.box(length, width, height).move(z=height / 2).material("#ffb300")
        nose = ui.scene.box(length / 4, width / 4, height / 4).material("#e65100")
        nose.move(x=length / 2, z=height)

    def _flag(self, place: SeenPlace) -> Object3D:
        with self._scene:
            flag = ui.scene.group().move(place.x, place.y, place.z)
            with flag:
                pole = ui.scene.cylinder(0.015, 0.015, POLE_M).material("#78909c")
                pole.rotate(1.5708, 0, 0).move(z=POLE_M / 2)
                ui.scene.box(0.2, 0.01, 0.12).material("#ab47bc").move(x=0.1, z=POLE_M - 0.06)
                ui.scene.text(place.name, LABEL).move(z=POLE_M + 0.1)
        return flag

    def _marker(self, mark: MapMark) -> Object3D:
        with self._scene:
            marker = ui.scene.group().move(mark.x, mark.y, mark.z)
            with marker:
                ui.scene.sphere(0.1).material(mark.colour)
                top_m = OVER_MARK_M
                if mark.picture is not None:
                    ui.scene.texture(mark.picture.address, [[*row] for row in picture_corners(mark.picture)])
                    top_m += PICTURE_M * mark.picture.height_to_width
                ui.scene.text(mark.name, LABEL).move(z=top_m + 0.05)
        return marker


def picture_corners(picture: MarkPicture) -> list[list[list[float]]]:
    """Return the corners of a picture relative to its mark, m: upper left and right, lower left and right."""
    right = -math.sin(picture.facing_rad), math.cos(picture.facing_rad)
    heights_m = OVER_MARK_M + PICTURE_M * picture.height_to_width, OVER_MARK_M
    return [
        [[side * right[0], side * right[1], height_m] for side in (-PICTURE_M / 2, PICTURE_M / 2)]
        for height_m in heights_m
    ]
