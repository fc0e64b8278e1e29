"""Modules of a robot that a log is played into; copied into the test's workspace."""

from typing import Any

from robbie_mp import Message, MessageHandling, Module, Upgrade, float32, setting, uint8
from robbie_mp.messages import DriveCommand, Image, TimeJump


def percent_to_ratio(fields: dict[str, Any]) -> dict[str, Any]:
    fields["ratio"] = fields.pop("percent") / 100
    return fields


def count_cells(fields: dict[str, Any]) -> dict[str, Any]:
    return {**fields, "cells": 4}


class Battery(
    Message,
    name="played_msgs/msg/Battery",
    version=3,
    upgrades={1: Upgrade(percent_to_ratio), 2: Upgrade(count_cells)},
):
    ratio: float32
    cells: uint8


class Witness(Module):
    """Writes down what it hears, and at which time of the run."""

    period_s: float = setting(0.1, "between looks at the clock")

    def setup(self) -> None:
        self.subscribe(DriveCommand, self.on_command)
        self.subscribe(Battery, self.on_battery)
        self.subscribe(TimeJump, self.on_jump)

    def on_command(self, command: DriveCommand) -> None:
        self.write("command", command.linear_m_per_s)

    def on_battery(self, battery: Battery) -> None:
        self.write("battery", round(battery.ratio * 100), battery.cells)

    def on_jump(self, jump: TimeJump) -> None:
        self.write("jump", jump.reason)

    def tick(self) -> None:
        self.write("tick")

    def write(self, *words: object) -> None:
        with open(self.output_directory / "witness.txt", "a") as file:
            print(self.clock.now_ns(), *words, file=file)


class Keeper(Module):
    """Keeps the newest image, as a page does that shows it."""

    def setup(self) -> None:
        self.newest: Image | None = None
        self.subscribe(Image, self.on_image, MessageHandling.KEEP_ONLY_NEWEST)

    def on_image(self, image: Image) -> None:
        self.newest = image
        self.status = f"keeps {image.data[0]}"
