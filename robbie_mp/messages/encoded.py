"""Checks of encoded messages, whose types may have no class in this program."""

from robbie_mp.messages.codec.cdr import CDR_LITTLE_ENDIAN, ENCAPSULATION_SIZE
from robbie_mp.messages.declaration import TYPE_NAME
from robbie_mp.messages.errors import DeclarationError, DecodeError, VersionError


def check_encapsulation(type_name: str, data: memoryview) -> None:
    """Check that bytes begin like an encoded message; further checks would need the class.

    Raises:
        DecodeError: they do not begin with a supported encapsulation.
    """
    if len(data) < ENCAPSULATION_SIZE or data[:2] != CDR_LITTLE_ENDIAN[:2]:
        begin = bytes(data[:ENCAPSULATION_SIZE]).hex(" ") or "nothing"
        raise DecodeError(
            f"{type_name}: {len(data)} bytes that begin with {begin} are not an encoded message; XCDR1 "
            "little endian begins with 00 01 00 00"
        )


def check_type(type_name: str, version: int) -> None:
    """Check the name and version of a type.

    Raises:
        DeclarationError: the name is not the full ROS name of a message type.
        VersionError: the version is less than 1.
    """
    if not TYPE_NAME.fullmatch(type_name):
        raise DeclarationError(f"{type_name!r} is not the full name of a type, as 'sensor_msgs/msg/Image'")
    if not 1 <= version < 1 << 32:
        raise VersionError(f"{type_name}: version {version}; versions are counted from 1")
