"""Which Robbie-MP this is, and which layout its shared memory has."""

LAYOUT_VERSION = 22
"""Raise this when you change anything in `robbie_mp/bus/transport/layout.py`."""


def installed_version() -> str:
    """Return the version of the installed package."""
    from importlib import metadata  # noqa: PLC0415 (every process imports this file, and few need the version)

    try:
        return metadata.version("robbie-mp")
    except metadata.PackageNotFoundError:
        return "(not installed)"
