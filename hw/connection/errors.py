"""Errors of devices. All are OSErrors, as those of the ports themselves."""


class DeviceFault(OSError):
    """The device reports an error, refuses a command, or is not the device that was expected."""


class DeviceSilent(DeviceFault, TimeoutError):
    """The device has sent nothing valid for too long."""
