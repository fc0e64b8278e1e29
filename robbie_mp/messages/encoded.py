"""Messages that are passed on as their bytes, of types that this program may have no class for."""

from robbie_mp.messages.codec.placement import ENCAPSULATION_SIZE
from robbie_mp.messages.declaration import TYPE_NAME
from robbie_mp.messages.errors import DeclarationError, DecodeError, VersionError

_CDR_LITTLE_ENDIAN = b"\x00\x01"


def check_encapsulation(type_name: str, data: memoryview) -> None:
    """See that bytes begin as an encoding does; nothing more can be said without the class.

    Raises:
        DecodeError: they do not.
    """
    if len(data) < ENCAPSULATION_SIZE or data[:2] != _CDR_LITTLE_ENDIAN:
        begin = bytes(data[:ENCAPSULATION_SIZE]).hex(" ") or "nothing"
        raise DecodeError(
            f"{type_name}: {len(data)} bytes that begin with {begin} are no encoding; XCDR1 little endian "
            "begins with 00 01 00 00"
        )


def check_type(type_name: str, version: int) -> None:
    """See that a type can be called so.

    Raises:
        DeclarationError: it is no ROS name.
        VersionError: versions are counted from 1.
    """
    if not TYPE_NAME.fullmatch(type_name):
        raise DeclarationError(f"{type_name!r} is no full name of a type such as 'sensor_msgs/msg/Image'")
    if not 1 <= version < 1 << 32:
        raise VersionError(f"{type_name}: version {version}; versions are counted from 1")
