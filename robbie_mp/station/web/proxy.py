"""A proxy in front of the station: the address at which it serves the page, and what it says of browsers."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit

from robbie_mp.base.errors import RobbieError

PORTS = {"http": 80, "https": 443}
"""Ports that browsers leave out of an origin (RFC 6454, section 6.2)."""
PATH = re.compile(r"(/[A-Za-z0-9_~-][A-Za-z0-9._~-]*)*/?")
"""Paths that need no escapes in a URL or a script."""
HOST = re.compile(r"[a-z0-9.-]+|\[[0-9a-f:.]+\]")
OWN_PATHS = frozenset(
    ("login", "logout", "tile", "pictures", "live", "emergency-stop", "_nicegui", "_nicegui_ws")
)
"""Begin the page's own paths. Below one of them, nobody could tell whether a proxy has cut off its path."""


class AddressInvalid(RobbieError, ValueError):
    """The public address, or the address of a proxy, is not one.

    Example scenarios:
      - `public_address: lab.example/robot1`, without `https://`
      - a host name where the address of a proxy is expected
    """


@dataclass(frozen=True)
class PublicAddress:
    """The address at which browsers open the page.

    Args:
        origin: scheme, host and port as browsers write them; '': the address on which the station listens.
        path: the beginning of all paths, such as `/robot1`; '': none.
    """

    origin: str = ""
    path: str = ""

    def __str__(self) -> str:
        return f"{self.origin}{self.path}/"

    def own_path(self, path: str) -> str:
        """Return a path as the station names it, whether or not a proxy has cut off the beginning."""
        return path[len(self.path) :] if f"{path}/".startswith(f"{self.path}/") else path


def public_address(text: str) -> PublicAddress:
    """Return the address that a profile names; '' is none.

    Raises:
        AddressInvalid: it is not an address.
    """
    if not text:
        return PublicAddress()
    try:
        parts = urlsplit(text)
        host, port = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname, parts.port
    except ValueError as error:
        raise AddressInvalid(f"{text!r} is no address: {error}") from None
    rest = (parts.query, parts.fragment, parts.username)
    if parts.scheme not in PORTS or not host or not HOST.fullmatch(host) or any(rest):
        raise AddressInvalid(f"expected an address such as https://lab.example/robot1/; got {text!r}")
    if not PATH.fullmatch(parts.path):
        raise AddressInvalid(f"expected letters, digits and ._~- between the slashes of {parts.path!r}")
    if (first := parts.path.strip("/").partition("/")[0]) in OWN_PATHS:
        raise AddressInvalid(f"the page has paths below /{first} itself: choose another one")
    own_port = "" if port in (None, PORTS[parts.scheme]) else f":{port}"
    return PublicAddress(f"{parts.scheme}://{host}{own_port}", parts.path.rstrip("/"))


def check_proxies(addresses: Sequence[str]) -> None:
    """Check that each is the address of a machine or of a network.

    Raises:
        AddressInvalid: one is not.
    """
    for one in addresses:
        try:
            ipaddress.ip_network(one)
        except ValueError as error:
            raise AddressInvalid(f"expected addresses such as 10.0.0.2 or 10.0.0.0/24: {error}") from None
