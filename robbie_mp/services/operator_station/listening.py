"""The address at which the page is to be found."""

import socket

from robbie_mp.errors import RobbieError


class AddressUnusable(RobbieError, OSError):
    """Nobody can listen on the address that the profile gives.

    Example scenarios:
      - another program, or another robot's station, uses the port
      - the host is no address of this machine
    """


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Args:
        host: address to listen on.
        port: 0 takes any that is free.

    Raises:
        AddressUnusable: the address is taken, or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise AddressUnusable(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "set another host or port for the operator station"
        ) from error
