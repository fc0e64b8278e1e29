"""Names for serial devices that stay the same at any socket: /dev/robbie/NAME, by rules for udev(7)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.install.unit import Installed

RULES = Path("etc/udev/rules.d/60-robbie.rules")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
SAFE = re.compile(r"[A-Za-z0-9 ._:+-]+")
"""Characters that a rule compares as they are. Other characters mean something to udev."""


class DeviceNotNamed(RobbieError, ValueError):
    """A device cannot get a name.

    Example scenarios:
      - no such device is plugged in
      - it is not a USB device, so nothing tells it from others
      - the name has a space or a slash
    """


@dataclass(frozen=True)
class UsbDevice:
    """A serial device on USB.

    Attributes:
        vendor: four hexadecimal digits.
        product: the same.
        serial_number: the maker's; '' if the device has none.
        socket: where it is plugged in, such as 1-1.2.
    """

    vendor: str
    product: str
    serial_number: str
    socket: str


def rules(devices: Mapping[str, UsbDevice], group: str, *, allows_wake_latency: bool = False) -> Installed:
    """Return the rules that name devices.

    A device without a serial number, or with one that a rule cannot compare, is known by its socket. Its name
    then belongs to whatever device of this kind is plugged in there.

    Args:
        devices: by their names.
        group: may use them.
        allows_wake_latency: whether the group may also limit how deeply processors sleep.

    Raises:
        DeviceNotNamed: a name cannot be one of a file, or two names are for the same device.
    """
    lines = ["# Written by `robbie install`; it writes the whole file."]
    known: dict[UsbDevice, str] = {}
    for name, device in devices.items():
        if not NAME.fullmatch(name):
            raise DeviceNotNamed(f"{name!r} is no name for a device; use letters, digits, - and _")
        if device in known:
            raise DeviceNotNamed(f"{name} and {known[device]} are the same device")
        known[device] = name
        number = device.serial_number
        which = f'ATTRS{{serial}}=="{number}"' if SAFE.fullmatch(number) else f'KERNELS=="{device.socket}"'
        if not SAFE.fullmatch(number):
            lines.append(
                f"# {name} has no serial number that can be used: it is what is in socket {device.socket}."
            )
        kind = f'ATTRS{{idVendor}}=="{device.vendor}", ATTRS{{idProduct}}=="{device.product}"'
        lines.append(
            f'SUBSYSTEM=="tty", {kind}, {which}, SYMLINK+="robbie/{name}", GROUP="{group}", MODE="0660"'
        )
    if allows_wake_latency:
        lines.append(f'KERNEL=="cpu_dma_latency", GROUP="{group}", MODE="0660"')
    return Installed(RULES, "\n".join(lines) + "\n")
