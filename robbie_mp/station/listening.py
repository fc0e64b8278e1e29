"""The address at which the page is to be found."""

import socket

from robbie_mp.errors import RobbieError

BACKLOG = 32
"""Connections that may be accepted at once."""

UNREAD_LIMIT_S = 20.0
"""Who takes nothing of what was sent for so long is disconnected."""
UNSENT_BYTES = 1 << 16
"""So much waits in the kernel for a browser; the rest waits where it is replaced by what is newer."""


class AddressUnusable(RobbieError, OSError):
    """Nobody can listen on the address that the profile gives.

    Example scenarios:
      - another program, or another robot's station, uses the port
      - the host is no address of this machine
    """


def listen(host: str, port: int, unread_limit_s: float = UNREAD_LIMIT_S) -> socket.socket:
    """Return a socket that listens.

    Args:
        host: address to listen on.
        port: 0 takes any that is free.
        unread_limit_s: who takes nothing of what was sent for so long is disconnected.

    Raises:
        AddressUnusable: the address is taken, or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        raise AddressUnusable(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "set another host or port for the operator station"
        ) from error
    # Connections have these from the socket that accepts them; tcp(7).
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(unread_limit_s * 1000))
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    return listener
