"""Teaching from the camera: an operator draws a box on a still picture, and names what is in it."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element
from starlette.responses import Response

from robbie_mp.messages import (
    BoundingBox2D,
    ForgetRecognition,
    Image,
    Point2D,
    Pose2D,
    TaughtNames,
    TeachRecognition,
    replace,
)
from robbie_mp.station.page.menus import commands, popup
from robbie_mp.station.watch.cameras import ImageBox
from robbie_mp.station.watch.pictures import answer_with, encode_image, no_picture, serve_pictures

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.cameras import Cameras
    from robbie_mp.station.watch.latest import MessageSource

ADDRESS = "/pictures/still/{key}"
MAX_STILLS = 32
"""Maximum number of pictures that stand still; a further one takes the place of the oldest."""
MAX_KINDS = 8
MAX_NAME = 64
SINGULAR = {"objects": "an object", "persons": "a person"}
"""What one thing of a kind is called."""
LOOK_S = 0.3
MIN_SHARE = 0.01
"""Minimum width and height of a box, as shares of those of the picture."""


class TeachingStage(Element, component="teaching_stage.js"):
    """Shows a picture that stands still, on which the visitor draws a box."""

    def __init__(self) -> None:
        super().__init__()
        self._props["address"] = ""

    def show(self, address: str) -> None:
        """Show the picture at an address; '' hides it."""
        self._props["address"] = address
        self.update()


class Teaching:
    """What modules have been taught, and the pictures from which operators teach.

    Args:
        messages: source of the messages.
        cameras: the cameras of the robot.
        words: suggestions for names.
    """

    def __init__(self, messages: MessageSource, cameras: Cameras, words: list[str]):
        self._messages = messages
        self._cameras = cameras
        self.words = words
        self._stills: OrderedDict[str, tuple[str, Image]] = OrderedDict()
        self.taught: dict[str, dict[str, int]] = {}
        """Number of examples of each name, by the topic of the module that knows them, which is its kind."""
        messages.hear(TaughtNames, self._on_names)
        serve_pictures(ADDRESS, self._answer)

    def _on_names(self, told: TaughtNames) -> None:
        kind = self._messages.envelope.topic
        if kind in self.taught or len(self.taught) < MAX_KINDS:
            names = dict(zip(told.names, told.examples.tolist(), strict=False))
            self.taught = {**self.taught, kind: names}  # a new dict, because pages read the old one

    def _answer(self, key: str) -> Response:
        still = self._stills.get(key)
        return (
            no_picture("there is no such picture") if still is None else answer_with(encode_image, still[1])
        )

    def hold(self, key: str, camera: str) -> bool:
        """Keep the newest image of a camera for a page.

        Returns:
            Whether there is one that can be taught from.
        """
        found = self._cameras.found.get(camera)
        image = found.latest.message if found else None
        if not isinstance(image, Image):
            return False
        # A copy, because a message that is kept for long holds the memory of its publisher.
        self._stills[key] = (camera, replace(image, data=image.data.copy()))
        while len(self._stills) > MAX_STILLS:
            self._stills.popitem(last=False)
        return True

    def still(self, key: str) -> tuple[str, Image] | None:
        """Return the camera and the image that a page keeps."""
        return self._stills.get(key)

    def release(self, key: str) -> None:
        """Drop a page's image."""
        self._stills.pop(key, None)

    def build(self, page: Page, panel: str, stage: Element, camera: Callable[[], str]) -> None:
        """Build the button, the picture that stands still, and the question for the name.

        Args:
            page: the operator's page.
            panel: name of the panel.
            stage: what shows the moving picture, which is hidden meanwhile.
            camera: returns the topic of the camera that is shown.
        """
        page.every(LOOK_S, panel, TeachingTools(self, page, stage, camera).tick)


class TeachingTools:
    """What one page has to teach with.

    Args:
        teaching: what is known, and the pictures that stand still.
        page: the operator's page.
        stage: what shows the moving picture.
        camera: returns the topic of the camera that is shown.
    """

    def __init__(self, teaching: Teaching, page: Page, stage: Element, camera: Callable[[], str]):
        self._teaching = teaching
        self._page = page
        self._moving = stage
        self._camera = camera
        self._shown: Mapping[str, Mapping[str, int]] = {}
        self._box: ImageBox | None = None
        self._pictures = 0
        self._still = TeachingStage()
        self._still.on("boxed", self._on_boxed)
        self._still.on("cancelled", self.end)
        label = "Teach objects and persons"
        self._button = (
            ui.button(icon="school")
            .classes("camera-teach")
            .props(f'id=teach dense color=dark aria-label="{label}" title="{label}"')
        )
        self._button.set_visibility(False)
        with self._button, popup(label, "teach-menu"):
            with commands():
                ui.menu_item("Draw a box on this picture …", on_click=self.begin).props("id=teach-begin")
            ui.separator()
            self._list = ui.column().classes("q-px-sm gap-0")
        # Only its buttons close it: the event that it is closed may come when the next picture is shown.
        with ui.dialog().props("persistent") as self._dialog, ui.card():
            ui.label("What is in the box?")
            self._kind = ui.toggle({}).props("id=teach-kind")
            self._name = ui.input("Name", autocomplete=teaching.words)
            self._name.props(f"for=teach-name autofocus maxlength={MAX_NAME}")
            self._name.on("keyup.enter", self._save)
            with ui.row():
                ui.button("Save", on_click=self._save).props("id=teach-save")
                ui.button("Cancel", on_click=self.end).props("flat")
        self._dialog.on_value_change(lambda event: None if event.value else self._forget_name())

    def tick(self) -> None:
        """Show what has been taught, if that has changed."""
        taught = self._teaching.taught
        if taught is self._shown:
            return
        self._shown = taught
        self._button.set_visibility(bool(taught))
        kinds = {kind: SINGULAR.get(kind, kind) for kind in taught}
        self._kind.set_options(kinds, value=self._kind.value or next(iter(kinds), None))
        self._list.clear()
        with self._list:
            for kind, names in taught.items():
                for name, examples in names.items():
                    self._build_entry(kind, name, examples)

    def _build_entry(self, kind: str, name: str, examples: int) -> None:
        with ui.row().classes("items-center no-wrap full-width"):
            ui.label(name).props(f'data-taught="{kind}"')
            ui.label(f"{kind}, {examples} {'picture' if examples == 1 else 'pictures'}").classes("text-xs")
            ui.space()
            remove = ui.button(icon="delete", on_click=lambda: self._forget(kind, name)).props("flat dense")
            remove.props["aria-label"] = f"Forget {name}"

    def begin(self) -> None:
        """Let the picture stand still, so that the operator can draw on it."""
        if not self._page.may("teaching"):
            return
        if not self._teaching.hold(self._page.key, self._camera()):
            ui.notify("this camera has sent no Image to teach from", type="negative")
            return
        self._pictures += 1
        self._still.show(f"{ADDRESS.replace('{key}', self._page.key)}?count={self._pictures}")
        # The robot is not driven by a picture that stands still.
        self._moving.set_visibility(False)

    def end(self) -> None:
        """Show the moving picture again."""
        self._box = None
        self._dialog.close()
        self._teaching.release(self._page.key)
        self._still.show("")
        self._moving.set_visibility(True)

    def _forget_name(self) -> None:
        # Not when the dialog opens: the page may get that late, and would drop what has been typed since.
        self._name.set_value("")

    def _on_boxed(self, event: GenericEventArguments) -> None:
        self._box = checked_box(event.args)
        if self._box is not None:
            self._dialog.open()

    def _save(self) -> None:
        still, box = self._teaching.still(self._page.key), self._box
        name, kind = str(self._name.value or "").strip(), str(self._kind.value or "")
        if not name or not kind:
            ui.notify("what is taught needs a name", type="warning")
            return
        self.end()
        if still is not None and box is not None:
            camera, image = still
            request = TeachRecognition(
                name=name, image=image, box=pixels_of_box(box, image), image_topic=camera
            )
            self._page.ask(request, "the teaching", f"{name} is learnt", topic=kind)

    def _forget(self, kind: str, name: str) -> None:
        self._page.ask(ForgetRecognition(name=name), "the request", f"{name} is forgotten", topic=kind)


def pixels_of_box(box: ImageBox, image: Image) -> BoundingBox2D:
    """Return a box in pixels of its image."""
    middle = Point2D(x=(box.left + box.width / 2) * image.width, y=(box.top + box.height / 2) * image.height)
    return BoundingBox2D(
        center=Pose2D(position=middle), size_x=box.width * image.width, size_y=box.height * image.height
    )


def checked_box(sent: Any) -> ImageBox | None:
    """Return the box that a page's script has sent, as shares of the picture, or None if it is malformed."""
    try:
        left, top, width, height = (float(sent[name]) for name in ("left", "top", "width", "height"))
    except (KeyError, TypeError, ValueError):
        return None
    numbers = (left, top, width, height)
    if not all(math.isfinite(one) and 0.0 <= one <= 1.0 for one in numbers) or min(width, height) < MIN_SHARE:
        return None
    return ImageBox(left, top, width, height, "")
