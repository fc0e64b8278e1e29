"""Modules of the campaign's robots, which write down what they send and receive."""

import os
from pathlib import Path

import numpy as np

from robbie_mp import Header, Message, Module, Time, setting
from robbie_mp.messages import Image, LinkState, String

CLASSES = ("command", "state", "reliable", "bulk", "urgent")
PAUSE_FILE = "pause"


class Journal:
    """A file that outlives the process, with a number in each line.

    Args:
        path: the file.
    """

    def __init__(self, path: Path):
        self._path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def note(self, number: int) -> None:
        """Write a number, with one system call."""
        os.write(self._file, b"%d\n" % number)

    def last(self) -> int:
        """Return the last number; 0 if there is none."""
        lines = self._path.read_text().split()
        return int(lines[-1]) if lines else 0


class Talker(Module):
    """Publishes numbered messages, on a topic for each class, until a file tells it to pause."""

    period_s: float = setting(0.02, "time between two messages of each topic")
    bytes: int = setting(20_000, "size of the bulk messages")

    def setup(self) -> None:
        """Open the journals."""
        self.journals = {one: Journal(self.output_directory / f"sent-{one}") for one in CLASSES}
        self.number = max(journal.last() for journal in self.journals.values())
        self.pixels = np.random.default_rng(1).integers(0, 255, self.bytes, np.uint8)

    def tick(self) -> None:
        """Publish a message of each class."""
        if (self.output_directory / PAUSE_FILE).exists():
            return
        self.number += 1
        for one, journal in self.journals.items():
            message: Message = String(data=str(self.number))
            if one == "bulk":
                message = Image(header=Header(stamp=Time(sec=self.number)), data=self.pixels)
            journal.note(self.number)  # first, so that no number is published twice if the robot is killed
            self.publish(message, topic=one)


class Listener(Module):
    """Writes down the numbers that it receives."""

    def setup(self) -> None:
        """Open the journals, and subscribe."""
        self.journals = {one: Journal(self.output_directory / f"got-{one}") for one in CLASSES}
        self.subscribe(String, self.on_text)
        self.subscribe(Image, self.on_image)

    def on_text(self, message: String) -> None:
        """Write down a number."""
        self.journals[self.envelope.topic].note(int(message.data))

    def on_image(self, image: Image) -> None:
        """Write down a number."""
        self.journals["bulk"].note(image.header.stamp.sec)


class Books(Module):
    """Writes down the last state of the link."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe(LinkState, self.on_state)

    def on_state(self, state: LinkState) -> None:
        """Replace the file with the state."""
        new = self.output_directory / "link.new"
        new.write_bytes(state.encode())
        new.replace(self.output_directory / "link.state")
