"""The elements of a page that switch the robot's lights."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import SetLight
from robbie_mp.station.page.slider import Slider
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.lights import LightId, LightsWatch

LOOK_S = 0.3
FULL_PERCENT = 100


class LightSwitch:
    """A button on the camera that switches all lights; it is there if the robot has any.

    Args:
        page: the operator's page.
        lights: the robot's lights.
        panel: name of the panel in which it is.
    """

    def __init__(self, page: Page, lights: LightsWatch, panel: str):
        self._lights = lights
        label = "Lights on or off"
        self._button = ui.button(icon="lightbulb", on_click=lambda: turn(lights, page)).classes(
            "camera-light"
        )
        self._button.props(f'id=lights dense color=dark aria-label="{label}" title="{label} (F)"')
        self._button.set_visibility(False)
        page.add_key("f", label, lambda: turn(lights, page))
        page.every(LOOK_S, panel, self._update)

    def _update(self) -> None:
        self._button.set_visibility(bool(self._lights.shown()))
        is_on = self._lights.are_on
        self._button.props(f"aria-pressed={str(is_on).lower()}")
        self._button.classes(add="is-on" if is_on else "", remove="" if is_on else "is-on")


class LightSliders:
    """A row for each light, with its brightness; an operator can change it.

    Args:
        page: the page.
        lights: the robot's lights.
    """

    def __init__(self, page: Page, lights: LightsWatch):
        self._page = page
        self._lights = lights
        self._rows: dict[LightId, tuple[Slider, ui.label]] = {}
        self._box = ui.element("div").classes("joint-controls").props("id=light-controls")

    def update(self) -> bool:
        """Show the brightness of all lights. Returns whether there are any."""
        shown = self._lights.shown()
        if list(shown) != list(self._rows):
            self._box.clear()
            with self._box:
                self._rows = {light: self._build_row(light) for light in shown}
        for light, brightness in shown.items():
            slider, text = self._rows[light]
            slider.set_enabled(self._page.role is Role.OPERATOR and brightness is not None)
            slider.set_value(round(FULL_PERCENT * (brightness or 0.0)))
            text.set_text("NOT KNOWN" if brightness is None else f"{brightness:.0%}")
        return bool(shown)

    def _build_row(self, light: LightId) -> tuple[Slider, ui.label]:
        with ui.element("div").classes("joint-row"):
            ui.label(light.name).classes("joint-name")
            step = 5 if light.can_dim else FULL_PERCENT
            slider = Slider(min=0, max=FULL_PERCENT, step=step).classes("light-slider")
            slider.props["aria-label"] = f"Brightness of the {light.name} in percent"
            slider.props["data-light"] = light.name
            slider.on_chosen(lambda percent: ask_for(self._page, light, percent / FULL_PERCENT))
            text = ui.label("").classes("joint-at").props(f'data-light-at="{light.name}"')
        return slider, text


def turn(lights: LightsWatch, page: Page) -> None:
    """Switch all lights off for an operator, or, if all are dark, on."""
    brightness = 0.0 if lights.are_on else 1.0
    for light in lights.shown():
        ask_for(page, light, brightness)


def ask_for(page: Page, light: LightId, brightness: float) -> None:
    """Ask for the brightness of a light; the page shows an error if its module refuses."""
    page.ask(SetLight(name=light.name, brightness=brightness), f"the {light.name}", topic=light.module)
