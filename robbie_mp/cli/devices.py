"""`robbie devices`: the serial devices that are plugged in."""

import argparse
import json
from dataclasses import asdict

from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.run.install.usb import serial_devices


def add_parser(subparsers: Commands) -> None:
    """Add `devices` to the commands."""
    parser = add_command(
        subparsers,
        "devices",
        "list the serial devices that are plugged in",
        "List the serial ports of this machine, and what tells the USB device at each from others: "
        "`robbie install --device` gives it a name by that.",
        ["robbie devices", "robbie devices --json"],
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=devices)


def devices(arguments: argparse.Namespace) -> int:
    """Print the devices."""
    found = serial_devices()
    if arguments.json:
        print(json.dumps({port: device and asdict(device) for port, device in found.items()}, indent=2))
        return 0
    for port, device in found.items():
        if device is None:
            print(f"{port}  not on USB")
        else:
            number = device.serial_number or "none"
            print(f"{port}  {device.vendor}:{device.product}  serial number {number}  socket {device.socket}")
    if not found:
        print("no serial device is plugged in")
    return 0
