"""Annotations of the map: the no-go areas and named places that people draw on it."""

from pathlib import Path

from robbie_mp import CallRefused, Header, Module, SettingError, setting
from robbie_mp.bus.checkpoint.file import write_file
from robbie_mp.messages import (
    AnnotateMap,
    MapAnnotated,
    MapAnnotations,
    MapAnnotationUndone,
    NoGoArea,
    Point,
    PointOfInterest,
    TimeJump,
    UndoMapAnnotation,
)
from robbie_robots.modules.maps.planar_messages import planar, pose_stamped
from robbie_robots.workers.maps.map_annotations import (
    AnnotatedMap,
    AnnotationError,
    AnnotationFileError,
    Annotations,
    annotations_path,
    read_annotations,
)


class MapAnnotator(Module):
    """Keeps what people draw on the map, and publishes it as `MapAnnotations`, which is latched.

    Serves `AnnotateMap` and `UndoMapAnnotation`. Each change is saved in a file beside the map's, with the
    suffix `.annotations.yaml`, before its client gets the reply. The annotations survive a restart of the
    module, and with `map_file` one of the robot.
    """

    map_file: Path | None = setting(
        None, "the map's file (YAML of ROS's map_server); null: the map that the robot makes in this run"
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Raise SettingError if the map's annotations cannot be read."""
        map_file = settings["map_file"]
        if isinstance(map_file, Path):
            try:
                read_annotations(annotations_path(map_file))
            except AnnotationFileError as error:
                raise SettingError(str(error), "map_file") from error

    def setup(self) -> None:
        """Find the annotations again, and serve changes."""
        self.file = annotations_path(self.map_file or self.output_directory / "map.yaml")
        self.map_name = "" if self.map_file is None else str(self.map_file)
        if self.restored is not None and self.restored["map_name"] == self.map_name:
            self.map = AnnotatedMap.from_state(self.restored["map"])
        else:
            self.map = AnnotatedMap() if self.map_file is None else read_annotations(self.file)
        self.serve(AnnotateMap, self.on_annotate)
        self.serve(UndoMapAnnotation, self.on_undo)
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        self._publish()

    def on_annotate(self, request: AnnotateMap) -> MapAnnotated:
        """Change the annotations, or refuse all of the change."""
        no_go = [(area.name, [(corner.x, corner.y) for corner in area.corners]) for area in request.no_go]
        places = [(place.name, planar(place.pose)) for place in request.places]
        try:
            changed = self.map.now.changed(request.remove, no_go, places)
        except AnnotationError as error:
            raise CallRefused(str(error)) from error
        self._keep(self.map.replaced(changed))
        return MapAnnotated(revision=self.map.revision)

    def on_undo(self, _request: UndoMapAnnotation) -> MapAnnotationUndone:
        """Take back the last change."""
        try:
            undone = self.map.undone()
        except AnnotationError as error:
            raise CallRefused(str(error)) from error
        self._keep(undone)
        return MapAnnotationUndone(revision=self.map.revision)

    def on_time_jump(self, jump: TimeJump) -> None:
        """Start without annotations if mapping starts a new map."""
        if self.map_file is None and self.map.now != Annotations():
            self.log.info("removed the annotations because time jumped (%s): a new map begins", jump.reason)
            self.map = AnnotatedMap(revision=self.map.revision + 1)
            self._remember()

    def _keep(self, changed: AnnotatedMap) -> None:
        """Save a change, then make it known."""
        try:
            write_file(self.file, changed.as_yaml().encode())
        except OSError as error:
            raise CallRefused(f"the annotations cannot be saved in {self.file}: {error.strerror}") from error
        self.map = changed
        self._remember()

    def _remember(self) -> None:
        self.checkpoint({"map_name": self.map_name, "map": self.map.state()})
        self._publish()

    def _publish(self) -> None:
        now = self.map.now
        header = Header(stamp=self.now(), frame_id="map")
        areas = [
            NoGoArea(name=name, corners=[Point(x=x_m, y=y_m) for x_m, y_m in corners])
            for name, corners in now.no_go.items()
        ]
        places = [
            PointOfInterest(name=name, pose=pose_stamped(place, header).pose)
            for name, place in now.places.items()
        ]
        self.publish(
            MapAnnotations(
                header=header,
                map_name=self.map_name,
                revision=self.map.revision,
                no_go=areas,
                places=places,
                can_undo=self.map.can_undo,
            ),
            latched=True,
        )
        self.status = f"revision {self.map.revision}: {len(areas)} no-go areas, {len(places)} places"
