"""The optional parts of Robbie-MP: which packages they need, and how to install what is missing."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from importlib import metadata

DISTRIBUTION = "robbie-mp"
REQUIREMENT = re.compile(r"([\w.-]+)\s*(?:>=\s*([0-9.]+))?[^;]*(?:;.*extra\s*==\s*[\"']([\w-]+)[\"'])?")


IMPORTED_AS = {
    "PIL": "pillow",
    "coal": "pin",
    "cv2": "opencv-python-headless",
    "dlib": "dlib-bin",
    "foxglove": "foxglove-sdk",
    "pinocchio": "pin",
    "serial": "pyserial",
    "zenoh": "eclipse-zenoh",
}
"""The packages of our extras that are not imported by their own names."""
NOT_INSTALLED = re.compile(r"No module named '(\w+)")


@dataclass(frozen=True)
class Requirement:
    """A package, its oldest version, and the extra that requires it ('': Robbie-MP itself)."""

    package: str
    oldest: str
    extra: str

    @classmethod
    def parse(cls, text: str) -> "Requirement":
        """Parse a requirement as Robbie-MP writes it: `scipy>=1.11; extra == "robot"`."""
        match = REQUIREMENT.match(text)
        package, oldest, extra = match.groups(default="") if match else (text, "", "")
        return cls(package, oldest, extra)


def own_requirements() -> list[Requirement]:
    """Return Robbie-MP's requirements as they were when it was installed."""
    return [Requirement.parse(text) for text in metadata.requires(DISTRIBUTION) or []]


def installed(package: str) -> str | None:
    """Return the version of a package; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def lacking(*extras: str) -> list[str]:
    """Return the requirements of extras that are not installed, as pip takes them."""
    return [text for text in _texts(extras) if installed(Requirement.parse(text).package) is None]


def how_to_install(*extras: str) -> str:
    """Return the command that installs what extras need.

    It names the packages, and not the extra: pip finds Robbie-MP itself only where it came from.
    """
    texts = lacking(*extras) or _texts(extras) or [f"{DISTRIBUTION}[{','.join(extras)}]"]
    return " ".join(["pip install", *(f"'{one}'" for one in texts)])


def what_to_install(failure: str) -> str:
    """Return what to do about a failed import: install one of our extras, or else what is missing.

    Args:
        failure: the text of the ImportError.
    """
    found = NOT_INSTALLED.search(failure)
    package = IMPORTED_AS.get(found[1], found[1].replace("_", "-")) if found else ""
    try:
        extra = next((one.extra for one in own_requirements() if one.extra and one.package == package), "")
    except metadata.PackageNotFoundError:  # only the files are here
        extra = ""
    return f"install the extra `{extra}`: {how_to_install(extra)}" if extra else "install what is missing"


def _texts(extras: Collection[str]) -> list[str]:
    try:
        every = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:  # only the files are here
        return []
    wanted = (text.partition(";")[0].strip() for text in every if Requirement.parse(text).extra in extras)
    return list(dict.fromkeys(wanted))
