"""Keep the machine's processors from deep sleep states, which take long to wake from."""

import os
import struct

DEVICE = "/dev/cpu_dma_latency"
HOW_TO_ALLOW = 'a udev rule allows it: KERNEL=="cpu_dma_latency", GROUP="robot", MODE="0660"'


def limit_wake_latency(latency_us: int) -> int:
    """Forbid sleep states that take longer than this to wake from; 0 forbids sleep altogether.

    Linux, Documentation/power/pm_qos_interface.rst.

    Returns:
        A file descriptor. The limit holds until you close it, or this process ends.

    Raises:
        OSError: the device is missing, or this user may not write to it.
    """
    device = os.open(DEVICE, os.O_WRONLY)
    try:
        os.write(device, struct.pack("=i", latency_us))
    except OSError:
        os.close(device)
        raise
    return device
