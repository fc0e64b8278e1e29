"""`robbie install PROFILE`: start a robot when its computer is switched on."""

import argparse
import grp
import os
import pwd
import sys
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.profile import add_profile_arguments, load
from robbie_mp.cli.run import check
from robbie_mp.run.doctor.needs import Needs
from robbie_mp.run.install.device_names import DeviceNotNamed, rules
from robbie_mp.run.install.unit import Installed, unit
from robbie_mp.run.install.usb import serial_devices, usb_device
from robbie_mp.run.profile.model import Profile

GROUPS = ("dialout", "video", "audio", "input", "plugdev")
"""Of those that exist, the robot's user becomes a member: they may use devices."""
DEVICE_GROUP = "dialout"


class CannotInstall(RobbieError, OSError):
    """The files for systemd and udev cannot be written.

    Example scenarios:
      - the user is not root
      - there is no user of that name
      - `robbie` was not installed by pip, so there is no program to start
    """


def add_parser(subparsers: Commands) -> None:
    """Add `install` to the commands."""
    parser = add_command(
        subparsers,
        "install",
        "start a robot when its computer is switched on",
        "Write a systemd unit that runs a profile at power-on, restarts it when it fails, kills it when it "
        "hangs, and allows it the descriptors, memory and priorities that it needs; and rules for udev that "
        "give devices names which stay the same at any USB socket. Nothing is started: the command prints "
        "what to do next.",
        [
            "sudo .venv/bin/robbie install rescue",
            "robbie install rescue --print",
            "sudo .venv/bin/robbie install rescue --user pilot --device laser-front=/dev/ttyUSB0",
        ],
    )
    add_profile_arguments(parser)
    parser.add_argument("--user", help="who runs the robot (you; under sudo, who called it)")
    parser.add_argument(
        "--device",
        dest="devices",
        metavar="NAME=PORT",
        action="append",
        default=[],
        help="name the serial device that is now at PORT /dev/robbie/NAME; may be repeated",
    )
    parser.add_argument("--print", action="store_true", help="print the files instead of writing them")
    parser.add_argument(
        "--root",
        type=Path,
        default=Path("/"),
        metavar="DIR",
        help="write below this folder, as for an image (/)",
    )
    parser.set_defaults(command=install)


def install(arguments: argparse.Namespace) -> int:
    """Write or print the files."""
    profile, _ = check(load(arguments))
    user = _user(arguments.user)
    files = [unit(profile, _command(arguments), user, _groups(), _shared_memory_bytes())]
    if arguments.devices or Needs.of(profile).limits_wake_latency:
        files.append(_rules(profile, arguments.devices))
    if arguments.print:
        for file in files:
            print(f"# {arguments.root / file.path}\n{file.text}")
        return 0
    for file in files:
        _write(arguments.root / file.path, file)
    print(_next_steps(files))
    return 0


def _user(name: str | None) -> str:
    name = name or os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    try:
        return pwd.getpwnam(name).pw_name
    except KeyError as error:
        raise CannotInstall(
            f"there is no user {name!r}; create one with `adduser`, or choose another"
        ) from error


def _groups() -> list[str]:
    existing = {group.gr_name for group in grp.getgrall()}
    return [name for name in GROUPS if name in existing]


def _command(arguments: argparse.Namespace) -> list[str]:
    program = Path(sys.executable).with_name("robbie")
    if not program.exists():
        raise CannotInstall(f"there is no {program}; install Robbie-MP with pip, and use that one")
    named = Path(arguments.profile)
    words = [str(program), "run", str(named.resolve()) if named.is_file() else arguments.profile, "--quiet"]
    for option, values in (
        ("--set", arguments.overrides),
        ("--var", arguments.variables),
        ("--without", arguments.without),
        ("--only", arguments.only),
    ):
        for value in values:
            words += [option, value]
    return words


def _shared_memory_bytes() -> int:
    room = os.statvfs(SHARED_MEMORY)
    return room.f_frsize * room.f_blocks


def _rules(profile: Profile, devices: list[str]) -> Installed:
    named = {}
    ports = serial_devices() if devices else {}
    for word in devices:
        name, equals, port = word.partition("=")
        if not equals:
            raise DeviceNotNamed(f"--device {word}: expected NAME=PORT, such as laser-front=/dev/ttyUSB0")
        if name in named:
            raise DeviceNotNamed(f"two devices are named {name}")
        named[name] = usb_device(port, ports)
    return rules(named, DEVICE_GROUP, allows_wake_latency=Needs.of(profile).limits_wake_latency)


def _write(path: Path, file: Installed) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(file.text)
    except OSError as error:
        raise CannotInstall(
            f"{path} cannot be written: {error.strerror}; use sudo, or --print to see what it would hold"
        ) from error
    print(f"wrote {path}")


def _next_steps(files: list[Installed]) -> str:
    name = files[0].path.name
    lines = ["now, as root:"]
    if len(files) > 1:
        lines.append("  udevadm control --reload && udevadm trigger")
    lines += [
        f"  systemctl daemon-reload && systemctl enable --now {name}",
        f"see how it does: systemctl status {name}; journalctl -u {name}; robbie top",
    ]
    return "\n".join(lines)
