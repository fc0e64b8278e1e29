"""What ui.scene does not have: points and lines in large numbers, and a picture that changes often."""

from nicegui.elements.scene.scene_object3d import Object3D

from robbie_mp.services.operator_station.scene_view.floor import Floor


class PointSet(Object3D, component="point_set.js"):
    """Points, or the corners of a line.

    Args:
        points: as `packed` makes them.
        size_px: of a point; 0: they are joined to a line.
    """

    def __init__(self, points: str = "", size_px: int = 3):
        super().__init__(points, size_px)

    def set_points(self, points: str) -> None:
        """Show other points."""
        if points != self.args[0]:
            self.args[0] = points
            self.run_method("set_points", points)


class FloorPicture(Object3D, component="floor.js"):
    """A map on the floor."""

    def __init__(self) -> None:
        super().__init__(None)
        self._shown: Floor | None = None

    def set_floor(self, floor: Floor | None) -> None:
        """Show another picture; None: none."""
        if floor is not self._shown:
            self._shown = floor
            self.args[0] = None if floor is None else [*floor]
            self.run_method("set_floor", self.args[0])
