"""Ports that modules of a run offer to each other: emulated devices."""

from pathlib import Path

RUN_PORT = "run:"
"""A port that begins with this is offered by the module that follows, in the same run."""


def offered_port(output_directory: Path, module: str) -> Path:
    """Return where a module of a run offers its port: a link to a pseudo-terminal.

    Args:
        output_directory: the run's.
        module: name of the module that emulates the device.
    """
    return output_directory / "ports" / module
