"""Copied into the workspace of tests: records all messages that come from the page."""

import json

from modules.rescue.messages import MissionOrder, VictimConfirmation
from robbie_mp import Module
from robbie_mp.messages import (
    DriveCommand,
    EmergencyStop,
    Mark,
    PlaybackControl,
    PoseStamped,
    SettingChange,
    String,
)

SOURCES = (
    (EmergencyStop, "emergency_stop"),
    (DriveCommand, "manual"),
    (PoseStamped, "goal"),
    (PoseStamped, "initial_pose"),
    (String, "speech_command"),
    (Mark, ""),
    (MissionOrder, ""),
    (PlaybackControl, ""),
    (VictimConfirmation, ""),
    (SettingChange, ""),
)


class Listener(Module):
    """Receives all messages from the operator station."""

    def setup(self) -> None:
        self.file = (self.output_directory / "heard.txt").open("a")
        for message_type, topic in SOURCES:
            self.subscribe(message_type, self.on_message, topic=topic)

    def on_message(self, message: object) -> None:
        if self.envelope.sender == "operator":
            engaged = getattr(message, "engaged", None)
            print(json.dumps([type(message).__name__, engaged]), file=self.file, flush=True)

    def teardown(self) -> None:
        self.file.close()
