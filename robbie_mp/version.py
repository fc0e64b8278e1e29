"""Which Robbie-MP this is."""

from importlib import metadata


def installed_version() -> str:
    """Return the version of the installed package."""
    try:
        return metadata.version("robbie-mp")
    except metadata.PackageNotFoundError:
        return "(not installed)"
