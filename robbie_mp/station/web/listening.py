"""The socket on which the station listens."""

import socket

from robbie_mp.base.errors import RobbieError

BACKLOG = 32
"""Length of the queue of connections that wait to be accepted."""

UNREAD_LIMIT_S = 20.0
"""A browser that reads nothing for this time is disconnected."""
UNSENT_BYTES = 1 << 16
"""Maximum number of bytes that wait in the kernel for a browser. The rest waits in this process, where newer
data replace it."""


class AddressUnusable(RobbieError, OSError):
    """The station cannot listen on the address in the profile.

    Example scenarios:
      - another program, or another robot's station, uses the port
      - the host is not an address of this machine
    """


def listen(host: str, port: int, unread_limit_s: float = UNREAD_LIMIT_S) -> socket.socket:
    """Return a socket that listens.

    Args:
        host: address to listen on.
        port: port to listen on; 0: any free one.
        unread_limit_s: a peer that reads nothing for this time is disconnected.

    Raises:
        AddressUnusable: the address is in use, or does not belong to this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        raise AddressUnusable(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "set another host or port for the operator station, "
            "as with `--set operator.port=0` (any free one)"
        ) from None
    # Accepted connections inherit these options; tcp(7).
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(unread_limit_s * 1000))
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    return listener
