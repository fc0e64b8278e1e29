"""Finds out why a robot does not let us connect: tries TLS with it, as a link would, and reads its answer.

Zenoh tries again without end, and logs at most a few words of the library's.
"""

import socket
import ssl
import time
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.link.keys import BUNDLE, CERTIFICATE, KEY, Keys

TIMEOUT_S = 5.0
ANSWER_S = 0.5
"""Time after which a robot that has not refused us has accepted us; more on a slow network."""


class NotConnected(RobbieError, ConnectionError):
    """No link to a robot is possible; the text says why, and what to do on which machine."""


def shake_hands(keys: Keys, host: str, port: int, timeout_s: float = TIMEOUT_S) -> str:
    """Connect to the link of another robot once, and return the name in its certificate.

    Args:
        keys: those of this robot.
        host: address of the other robot.
        port: where its link listens.
        timeout_s: time limit for each step.

    Raises:
        NotConnected: it cannot be reached, one does not trust the other, or a certificate has expired.
        KeysError: the keys of this robot cannot be used.
    """
    keys.zenoh_settings()  # checks them
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # addresses of robots change; its authority says which robot it is
    context.load_verify_locations(keys.folder / BUNDLE)
    context.load_cert_chain(keys.folder / CERTIFICATE, keys.folder / KEY)
    where = f"{host}:{port}"
    try:
        started_s = time.monotonic()
        with (
            socket.create_connection((host, port), timeout_s) as plain,
            context.wrap_socket(plain) as connection,
        ):
            connection.settimeout(max(ANSWER_S, 3 * (time.monotonic() - started_s)))
            name = _name_in(connection)
            try:
                ended = connection.recv(1) == b""
            except TimeoutError:
                ended = False  # it waits for us to speak
    except ssl.SSLError as error:
        raise NotConnected(f"{where}: {_reason(keys, error)}") from error
    except OSError as error:
        raise NotConnected(f"{where}: no robot answers there: {error.strerror or error}") from error
    if ended:
        raise NotConnected(f"{where}: {name} has ended the connection without a reason")
    return name


def _name_in(connection: ssl.SSLSocket) -> str:
    certificate = connection.getpeercert() or {}
    subject = certificate.get("subject", ())
    assert isinstance(subject, tuple)
    return next((str(pair[1]) for group in subject for pair in group if pair[0] == "commonName"), "?")


def _reason(keys: Keys, error: ssl.SSLError) -> str:
    own: Path = keys.own().file
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_message == "certificate has expired":
            return "its certificate has expired; make a new one there: robbie keys new --replace"
        return "it is not trusted here; copy its NAME.pem and trust it: robbie keys trust NAME.pem"
    reason = error.reason or ""
    if "UNKNOWN_CA" in reason or "BAD_CERTIFICATE" in reason or "DECRYPT_ERROR" in reason:
        return (
            f"it does not trust this robot; copy {own} there, then there: robbie keys trust {own.name}, "
            f"and restart its link"
        )
    if "CERTIFICATE_EXPIRED" in reason:
        return "it says that our certificate has expired; compare the clocks of both machines"
    if "WRONG_VERSION_NUMBER" in reason:
        return "what listens there does not speak TLS"
    return f"TLS fails: {reason or error}"
