"""Recognizes in camera images what people have taught the robot: objects and persons."""

from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from robbie_mp import CallRefused, Header, MessageHandling, Module, SettingError, setting
from robbie_mp.attached.views.image_pixels import DEPTHS, NoPicture, pixels_of
from robbie_mp.bus.checkpoint.file import write_file
from robbie_mp.messages import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    ForgetRecognition,
    Image,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    Point2D,
    Pose2D,
    RecognitionForgotten,
    RecognitionTaught,
    TaughtNames,
    TeachRecognition,
)
from robbie_robots.modules.sensor_deadlines import CAMERA_S
from robbie_robots.workers.faces.face_recognition import MAX_DISTANCE, FaceRecognizer
from robbie_robots.workers.objects.object_recognition import ObjectRecognizer
from robbie_robots.workers.taught import (
    Box,
    Pixels,
    Recognizer,
    Sighting,
    TaughtFileError,
    TeachingError,
    as_json,
    read_taught,
)


class TaughtRecognition(Module):
    """Base class of modules that recognize what people have taught them.

    Serves `TeachRecognition` and `ForgetRecognition` on the topic `kind`. Each change is saved in a file
    before its client gets the reply, and published as `TaughtNames` on the same topic, latched. The module
    publishes what it sees as `Detection2DArray` on the image's topic; what has no known name has no results.
    """

    camera: str = setting("camera", "topic of the images to search")
    taught_file: Path | None = setting(
        None, "where what was taught is kept (JSON); null: in the run's folder, and it ends with the run"
    )
    period_s: float = setting(0.2, "minimum time between two images that are searched", minimum=0.02)

    kind: ClassVar[str]
    """The topic of the services, and the kind in the file."""
    used_settings: ClassVar[tuple[str, ...]] = ()
    """Names of the settings that `make_recognizer` uses."""
    unknown: ClassVar[str] = ""
    """What a sighting of something unknown is called."""

    @classmethod
    @abstractmethod
    def make_recognizer(cls, settings: dict[str, Any]) -> Recognizer:
        """Return the recognizer.

        Raises:
            ImportError: a library is missing.
        """

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Raise SettingError if what was taught cannot be read.

        Raises:
            ImportError: a library is missing; with `optional: true` in its profile, a robot does without.
        """
        recognizer = cls.make_recognizer(settings)
        file = settings["taught_file"]
        if isinstance(file, Path):
            try:
                recognizer.restore(read_taught(file, cls.kind))
            except TaughtFileError as error:
                raise SettingError(str(error), "taught_file") from error
            except TeachingError as error:
                raise SettingError(f"{file}: {error}", "taught_file") from error

    def setup(self) -> None:
        """Read what was taught, and serve changes."""
        self.recognizer = self.make_recognizer({name: getattr(self, name) for name in self.used_settings})
        self.file = self.taught_file or self.output_directory / f"taught_{self.kind}.json"
        try:
            self.recognizer.restore(read_taught(self.file, self.kind))
        except (TaughtFileError, TeachingError) as error:
            self.log.error("starts without what was taught: %s", error)
        self.image: Image | None = None
        self.images = self.sightings = self.unusable = 0
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(Image, self.on_image, newest, topic=self.camera, deadline_s=CAMERA_S)
        self.serve(TeachRecognition, self.on_teach, topic=self.kind)
        self.serve(ForgetRecognition, self.on_forget, topic=self.kind)
        self._publish_names()

    def on_image(self, image: Image) -> None:
        """Keep the newest image until the next tick."""
        self.image = image

    def on_teach(self, request: TeachRecognition) -> RecognitionTaught:
        """Learn an example, or refuse it."""
        box = request.box
        middle = box.center.position
        corner = (middle.x - box.size_x / 2, middle.y - box.size_y / 2)
        before = self.recognizer.plain()
        try:
            pixels = in_colour(request.image)
            self.recognizer.teach(request.name, pixels, Box(*corner, box.size_x, box.size_y))
        except (NoPicture, TeachingError) as error:
            raise CallRefused(str(error)) from error
        self._save(before)
        return RecognitionTaught(examples=self.recognizer.examples()[request.name.strip()])

    def on_forget(self, request: ForgetRecognition) -> RecognitionForgotten:
        """Forget a name, or refuse."""
        before = self.recognizer.plain()
        try:
            self.recognizer.forget(request.name)
        except TeachingError as error:
            raise CallRefused(str(error)) from error
        self._save(before)
        return RecognitionForgotten()

    def tick(self) -> None:
        """Search the newest image."""
        image, self.image = self.image, None
        if image is not None:
            self._search(image)
        examples = self.recognizer.examples()
        unusable = f", {self.unusable} unusable" if self.unusable else ""
        self.status = (
            f"knows {len(examples)} {self.kind}; {self.sightings} seen in {self.images} images{unusable}"
        )

    def _search(self, image: Image) -> None:
        try:
            sightings = self.recognizer.find(in_colour(image))
        except NoPicture as error:
            self.unusable += 1
            self.log.debug("could not use an image: %s", error)
            return
        self.images += 1
        self.sightings += len(sightings)
        found = [self._detection(image.header, one) for one in sightings]
        self.publish(Detection2DArray(header=image.header, detections=found), topic=self.camera)

    def _detection(self, header: Header, one: Sighting) -> Detection2D:
        hypothesis = ObjectHypothesis(class_id=one.name, score=one.confidence)
        return Detection2D(
            header=header,
            results=[ObjectHypothesisWithPose(hypothesis=hypothesis)] if one.name else [],
            bbox=bounding_box(one.box),
            id=one.name or self.unknown,
        )

    def _save(self, before: dict[str, list[Any]]) -> None:
        """Save a change, or take it back; then make it known."""
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.file, as_json(self.kind, self.recognizer.plain()))
        except OSError as error:
            self.recognizer.restore(before)
            raise CallRefused(f"it cannot be saved in {self.file}: {error.strerror}") from error
        self._publish_names()

    def _publish_names(self) -> None:
        examples = self.recognizer.examples()
        counts = np.array([*examples.values()], np.uint32)
        self.publish(TaughtNames(names=[*examples], examples=counts), topic=self.kind, latched=True)


class TaughtObjects(TaughtRecognition):
    """Recognizes objects by what is printed on them, after one picture of each."""

    kind = "objects"

    @classmethod
    def make_recognizer(cls, settings: dict[str, Any]) -> Recognizer:
        """Return a recognizer of objects."""
        return ObjectRecognizer()


class TaughtFaces(TaughtRecognition):
    """Recognizes persons by their faces, after one picture of each. Unknown faces are called "face"."""

    max_distance: float = setting(
        MAX_DISTANCE,
        "maximum distance of two descriptions of the same person; a smaller one confuses fewer persons",
        minimum=0.1,
        maximum=1.0,
    )

    doublings: int = setting(
        0,
        "how often images are doubled in size to find smaller faces: 0 finds faces of 80 pixels, 1 of 40",
        minimum=0,
        maximum=2,
    )

    kind = "persons"
    unknown = "face"
    used_settings = ("max_distance", "doublings")

    @classmethod
    def make_recognizer(cls, settings: dict[str, Any]) -> Recognizer:
        """Return a recognizer of faces."""
        return FaceRecognizer(settings["max_distance"], settings["doublings"])


def in_colour(image: Image) -> Pixels:
    """Return an image as (height, width, 3), red, green, blue.

    Raises:
        NoPicture: it has depths or an unknown encoding, or is damaged.
    """
    if image.encoding in DEPTHS:
        raise NoPicture(f"the image has depths (it is encoded as {image.encoding!r}); show one of a camera")
    pixels = pixels_of(image)
    return pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)


def bounding_box(box: Box) -> BoundingBox2D:
    """Return a box as messages have it."""
    middle = Point2D(x=box.left + box.width / 2, y=box.top + box.height / 2)
    return BoundingBox2D(center=Pose2D(position=middle), size_x=box.width, size_y=box.height)
