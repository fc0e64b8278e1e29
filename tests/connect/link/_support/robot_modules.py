"""Modules of two linked robots, which write down what they send and receive; copied into a workspace."""

import os
from pathlib import Path

import numpy as np

from robbie_mp import Duration, Header, Message, Module, Time, setting
from robbie_mp.messages import DriveCommand, EmergencyStop, Image, LinkState, OccupancyGrid, String, float64

CLASSES = ("command", "state", "reliable", "bulk", "urgent")


class Journal:
    """A file that survives the death of the process, one number per line."""

    def __init__(self, path: Path):
        self.path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def note(self, number: int) -> None:
        os.write(self._file, b"%d\n" % number)

    def last(self) -> int:
        lines = self.path.read_text().split()
        return int(lines[-1]) if lines else 0


class Sample(Message, name="crew/msg/Sample", version=3):
    """A type of the robot's own."""

    moisture_percent: float64 = 0.0


class Sampler(Module):
    """Publishes samples."""

    period_s = 0.05

    def tick(self) -> None:
        self.publish(Sample(moisture_percent=12.5), topic="soil")


class Talker(Module):
    """Publishes numbered messages, on a topic for each class."""

    period_s: float = setting(0.02, "time between two messages of each topic")
    count: int = setting(1_000_000, "messages of each topic")
    bytes: int = setting(20_000, "size of the bulk messages")

    def setup(self) -> None:
        self.journals = {one: Journal(self.output_directory / f"sent-{one}") for one in CLASSES}
        self.refused = {one: Journal(self.output_directory / f"refused-{one}") for one in CLASSES}
        self.number = max(journal.last() for journal in self.journals.values())
        self.pixels = np.random.default_rng(1).integers(0, 255, self.bytes, np.uint8)

    def tick(self) -> None:
        if self.number == 0:
            self.publish(OccupancyGrid(header=self.numbered(7)), topic="map", latched=True)
        if self.number >= self.count:
            return
        self.number += 1
        for one, journal in self.journals.items():
            message: Message = String(data=str(self.number))
            if one == "bulk":
                message = Image(header=self.numbered(self.number), data=self.pixels)
            journal.note(self.number)  # first: a number is never published twice, even after a kill
            if not self.publish(message, topic=one):
                self.refused[one].note(self.number)

    def numbered(self, number: int) -> Header:
        return Header(stamp=Time(sec=number))


class Listener(Module):
    """Writes down the numbers that it receives, and how the link is doing."""

    def setup(self) -> None:
        self.journals = {one: Journal(self.output_directory / f"got-{one}") for one in (*CLASSES, "map")}
        self.subscribe(String, self.on_text)
        self.subscribe(Image, self.on_image)
        self.subscribe(OccupancyGrid, self.on_map, topic="map", optional=True)

    def on_text(self, message: String) -> None:
        self.journals[self.envelope.topic].note(int(message.data))

    def on_image(self, image: Image) -> None:
        self.journals["bulk"].note(image.header.stamp.sec)

    def on_map(self, grid: OccupancyGrid) -> None:
        self.journals["map"].note(grid.header.stamp.sec)


class Books(Module):
    """Writes down the last state of the link."""

    def setup(self) -> None:
        self.subscribe(LinkState, self.on_state)

    def on_state(self, state: LinkState) -> None:
        new = self.output_directory / "link.new"
        new.write_bytes(state.encode())
        new.replace(self.output_directory / "link.state")


class Pilot(Module):
    """Sends drive commands, and the emergency stop when a file says so."""

    period_s = 0.05
    valid_for_s: float = setting(0.22, "time for which a command is valid")

    def tick(self) -> None:
        valid_for = Duration.from_nanoseconds(round(self.valid_for_s * 1e9))
        speed = 0.0 if (self.output_directory / "let_go").exists() else 0.5
        self.publish(DriveCommand(linear_m_per_s=speed, valid_for=valid_for), topic="manual")
        if (self.output_directory / "stop").exists():
            self.publish(EmergencyStop(engaged=True, reason="test"), topic="emergency_stop")


class Wheels(Module):
    """A base that drives while a command is valid, and writes down how long its commands last, in ms."""

    def setup(self) -> None:
        self.commands = Journal(self.output_directory / "commands")
        self.stops = Journal(self.output_directory / "stops")
        self.subscribe(DriveCommand, self.on_command)
        self.subscribe(EmergencyStop, self.on_stop)

    def on_command(self, command: DriveCommand) -> None:
        self.commands.note(command.valid_for.nanoseconds // 1_000_000)

    def on_stop(self, stop: EmergencyStop) -> None:
        self.stops.note(int(stop.engaged))
