"""Copied into the workspace of tests: records all messages that come from the page."""

import json

from robbie_mp import EncodedMessage, Module
from robbie_mp.messages import (
    DriveCommand,
    EmergencyStop,
    Mark,
    PlaybackControl,
    PoseStamped,
    SettingChange,
    String,
)

REQUESTS = ("*/srv/*", "*/action/*")
"""Types of requests and goals."""
SOURCES = (
    (EmergencyStop, "emergency_stop"),
    (DriveCommand, "manual"),
    (PoseStamped, "initial_pose"),
    (String, "speech_command"),
    (Mark, ""),
    (PlaybackControl, ""),
    (SettingChange, ""),
)


class Listener(Module):
    """Receives all messages from the operator station."""

    def setup(self) -> None:
        self.file = (self.output_directory / "heard.txt").open("a")
        for message_type, topic in SOURCES:
            self.subscribe(message_type, self.on_message, topic=topic)
        for pattern in REQUESTS:
            self.subscribe_encoded(pattern, self.on_request)

    def on_message(self, message: object) -> None:
        if self.envelope.sender == "operator":
            engaged = getattr(message, "engaged", None)
            print(json.dumps([type(message).__name__, engaged]), file=self.file, flush=True)

    def on_request(self, request: EncodedMessage) -> None:
        if self.envelope.sender == "operator":
            print(json.dumps([request.type_name, None]), file=self.file, flush=True)

    def teardown(self) -> None:
        self.file.close()
