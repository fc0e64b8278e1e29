"""The serial devices that are plugged in."""

from pathlib import Path

from robbie_mp.run.install.device_names import DeviceNotNamed, UsbDevice


def serial_devices() -> dict[str, UsbDevice | None]:
    """Return the serial ports of this machine, each with its USB device; None if it is not on USB.

    Raises:
        DeviceNotNamed: pyserial is missing.
    """
    try:
        from serial.tools.list_ports import comports  # noqa: PLC0415 - an extra that only devices need
    except ImportError as error:
        raise DeviceNotNamed("serial ports need pyserial: pip install pyserial") from error
    found: dict[str, UsbDevice | None] = {}
    for port in comports():
        found[port.device] = None
        if port.vid is not None and port.pid is not None:
            socket = (port.location or "").partition(":")[0]
            found[port.device] = UsbDevice(
                f"{port.vid:04x}", f"{port.pid:04x}", port.serial_number or "", socket
            )
    return found


def usb_device(port: str, ports: dict[str, UsbDevice | None]) -> UsbDevice:
    """Return the device at a port, such as /dev/ttyUSB0 or a link to it.

    Raises:
        DeviceNotNamed: there is none, or it is not on USB.
    """
    real = str(Path(port).resolve())
    if real not in ports:
        near = ", ".join(ports) or "none"
        raise DeviceNotNamed(f"no serial device is plugged in at {port}; there are: {near}")
    device = ports[real]
    if device is None:
        raise DeviceNotNamed(f"{port} is not on USB; its name {real} stays the same anyway")
    return device
