"""Who may reach what listens on the network: the rule for every module that opens a port."""

import ipaddress

from robbie_mp.module.secret import Secret
from robbie_mp.module.settings import SettingError

MIN_TOKEN_CHARACTERS = 16
"""Minimum number of characters: too many to guess at the limited rate of wrong tokens."""


def check_listening(host: str, needed: str, **tokens: Secret | None) -> None:
    """Check that nobody on another machine can connect without a token that cannot be guessed.

    Args:
        host: the address to listen on.
        needed: the name of the token without which the module listens for this machine only.
        tokens: the secrets by the names of their settings.

    Raises:
        SettingError: a token is short, or other machines can reach the address without one.
    """
    for name, token in tokens.items():
        if token is not None and len(token.reveal()) < MIN_TOKEN_CHARACTERS:
            raise SettingError(f"expected at least {MIN_TOKEN_CHARACTERS} characters; got fewer", name)
    if tokens[needed] is None and not is_loopback(host):
        raise SettingError(
            f"{host} can be reached from other machines: set {needed} to the place of a secret with at "
            f"least {MIN_TOKEN_CHARACTERS} characters, or set host to 127.0.0.1",
            "host",
        )


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address to listen on."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
