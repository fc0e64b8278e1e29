"""The buttons that keep what happens now: a recording, and pictures of all cameras."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.station.page.state_item import clock_text
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.past.recordings import RunRecorder
    from robbie_mp.station.past.snapshots import Snapshots

PERIOD_S = 0.3
RECORD, RECORDING = "fiber_manual_record", "stop"
ENDING = "ends"
NO_CAMERA = "no camera has sent a picture"


class RecordButton:
    """Starts and stops a recording. Every page shows how long it has lasted, whichever page started it.

    Args:
        recorder: makes the recordings.
    """

    def __init__(self, recorder: RunRecorder):
        self._recorder = recorder

    def build(self, page: Page) -> None:
        """Build the button. Observers see only what is recorded."""
        recorder = self._recorder

        def turn() -> None:
            if page.may("a recording"):
                recorder.stop() if recorder.name else recorder.start()
                update()

        button = ui.button("REC", icon=RECORD, on_click=turn, color=None)
        button.props("flat dense no-caps id=record").classes("record-button")
        button.set_enabled(page.role is Role.OPERATOR)
        told = [recorder.error]

        def update() -> None:
            is_on = bool(recorder.name)
            lasted = ENDING if recorder.is_ending else clock_text(recorder.seconds)
            button.set_text(lasted if is_on else "REC")
            button.set_icon(RECORDING if is_on else RECORD)
            button.classes(add="is-recording" if is_on else "", remove="" if is_on else "is-recording")
            label = "Stop the recording" if is_on else "Record all messages"
            if button.props.get("title") != label:
                button.props["aria-label"] = button.props["title"] = label
                button.props["aria-pressed"] = "true" if is_on else "false"
            if recorder.error != told[0]:
                told[0] = recorder.error
                if recorder.error:
                    ui.notify(f"the recording has ended: {recorder.error}", type="negative")

        update()
        page.always(PERIOD_S, update)


class SnapshotButton:
    """Keeps the newest picture of each camera.

    Args:
        snapshots: keeps them.
    """

    def __init__(self, snapshots: Snapshots):
        self._snapshots = snapshots

    def build(self, page: Page) -> None:
        """Build the button. Observers have none."""
        if page.role is not Role.OPERATOR:
            return

        async def take() -> None:
            if not page.may("a snapshot"):
                return
            kept, problems = await asyncio.to_thread(self._snapshots.take)
            if kept or not problems:
                ui.notify(f"snapshot of {', '.join(kept)}" if kept else NO_CAMERA)
            for problem in problems:
                ui.notify(f"no snapshot of {problem}", type="negative")

        page.add_key("i", "Keep the pictures of all cameras", take)
        button = ui.button(icon="add_a_photo", on_click=take).props("flat dense color=white id=snapshot")
        button.props["aria-label"] = button.props["title"] = "Keep the pictures of all cameras"
