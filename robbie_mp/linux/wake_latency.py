"""Keep the machine's processors from deep sleep, from which it takes them long to wake up."""

import os
import struct

DEVICE = "/dev/cpu_dma_latency"
HOW_TO_ALLOW = 'a udev rule allows it: KERNEL=="cpu_dma_latency", GROUP="robot", MODE="0660"'


def limit_wake_latency(latency_us: int) -> int:
    """Let no processor sleep so deep that it takes longer to wake up; 0: let none sleep at all.

    Linux, Documentation/power/pm_qos_interface.rst.

    Returns:
        A file descriptor: the limit holds until it is closed, at the latest by the end of this process.

    Raises:
        OSError: there is no such device, or we may not write it.
    """
    device = os.open(DEVICE, os.O_WRONLY)
    try:
        os.write(device, struct.pack("=i", latency_us))
    except OSError:
        os.close(device)
        raise
    return device
