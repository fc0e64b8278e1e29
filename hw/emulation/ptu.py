"""An emulated pan-tilt unit PTU-46 with its text protocol.

Source: Directed Perception, Pan-Tilt Unit (Model PTU) User's Manual.
"""

import re
from dataclasses import dataclass

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

ARC_SECONDS_PER_STEP = 185.1428
STEP_S = 0.02
MAX_RECEIVED_BYTES = 256
NAMES = {"P": "Pan", "T": "Tilt"}
_COMMAND = re.compile(r"([PT])([PSORNX])(-?\d+)?", re.ASCII)
VERSION = "Pan-Tilt Controller v2.12.1d1(C14/E), (C)2003 Directed Perception, Inc., All Rights Reserved"


@dataclass
class PtuJoint:
    """One joint, in steps.

    Attributes:
        least: least position.
        most: greatest position.
        position: where it is.
        goal: where it goes.
        speed: steps each second.
    """

    least: int
    most: int
    position: float = 0.0
    goal: int = 0
    speed: int = 1000


class EmulatedPtu(EmulatedDevice):
    """A unit that looks straight ahead after power-on; it repeats what it hears, and answers in sentences.

    Attributes:
        joints: "P" pan, positive to the left, and "T" tilt, positive up.
        repeats: whether it repeats commands.
        is_verbose: whether it answers in sentences.
    """

    bit_rate = 9600

    def __init__(self, clock: EmulatedClock | None = None) -> None:
        super().__init__(clock)
        self.power_on()

    def power_on(self) -> None:
        """Look straight ahead, with the maker's values."""
        self.joints = {"P": PtuJoint(-3090, 3090), "T": PtuJoint(-907, 604)}
        self.repeats = self.is_verbose = True
        self._received = ""
        self._moved_s = self.clock.now_s()

    def receive(self, data: bytes) -> None:
        """Obey commands, each of which ends with a blank or a line end."""
        text = data.decode("ascii", "replace")
        if self.repeats:
            self.send(text.encode("ascii", "replace"))
        *commands, self._received = re.split(r"[ \r\n]", self._received + text)
        self._received = self._received[-MAX_RECEIVED_BYTES:]
        for command in commands:
            if command:
                self._obey(command.upper())

    def step(self) -> float | None:
        """Turn the joints."""
        now_s = self.clock.now_s()
        passed_s, self._moved_s = max(0.0, now_s - self._moved_s), now_s
        for joint in self.joints.values():
            most = joint.speed * passed_s
            joint.position += max(-most, min(most, joint.goal - joint.position))
        return now_s + STEP_S

    def _obey(self, command: str) -> None:
        self.step()
        if command in ("ED", "EE"):
            self.repeats = command == "EE"
            self._answer("")
        elif command in ("FT", "FV"):
            self.is_verbose = command == "FV"
            self._answer("")
        elif command in ("I", "S", "A", "CI", "LE", "LD"):
            self._answer("")
        elif command in ("H", "HP", "HT"):
            for name, joint in self.joints.items():
                if command in ("H", f"H{name}"):
                    joint.goal = round(joint.position)
            self._answer("")
        elif command == "V":
            self._answer(VERSION)
        elif (match := _COMMAND.fullmatch(command)) is not None:
            self._joint(*match.groups())
        else:
            self._refuse("Illegal command entered")

    def _joint(self, name: str, what: str, told: str | None) -> None:
        joint, spoken = self.joints[name], NAMES[name]
        if told is None:
            value, verbose = {
                "P": (str(round(joint.position)), f"Current {spoken} position is"),
                "O": (str(joint.goal - round(joint.position)), f"Current {spoken} offset is"),
                "S": (str(joint.speed), f"Target {spoken} speed is"),
                "R": (f"{ARC_SECONDS_PER_STEP}", ""),
                "N": (str(joint.least), f"Minimum {spoken} position is"),
                "X": (str(joint.most), f"Maximum {spoken} position is"),
            }[what]
            if what == "R" and self.is_verbose:
                self._answer(f"{value} seconds arc per {spoken} position")
            else:
                self._answer(f"{verbose} {value}" if self.is_verbose else value)
        elif what in "PO":
            goal = int(told) + (round(joint.position) if what == "O" else 0)
            if goal > joint.most:
                self._refuse(f"Maximum allowable {spoken} position is {joint.most}")
            elif goal < joint.least:
                self._refuse(f"Minimum allowable {spoken} position is {joint.least}")
            else:
                joint.goal = goal
                self._answer("")
        elif what == "S" and 0 < int(told) <= 2902:
            joint.speed = int(told)
            self._answer("")
        else:
            self._refuse("Illegal argument")

    def _answer(self, text: str) -> None:
        self.send(f"* {text}\r\n".encode() if text else b"*\r\n")

    def _refuse(self, text: str) -> None:
        self.send(f"! {text}\r\n".encode())
