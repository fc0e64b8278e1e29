"""The keys of this robot, and the robots that it trusts: nobody else may connect to its link or read it.

`Keys.make` makes an authority that signs one certificate, that of this robot, and forgets the authority's
key: nobody can sign another certificate with it. The authority's own certificate is public. Robots that have
exchanged these trust each other, because TLS accepts only certificates that a trusted authority has signed
(RFC 8446 and RFC 5280; mutual TLS of Zenoh).

    keys = Keys(default_folder())
    keys.make("robot1")                 # on the robot; copy robot1.pem to the laptop
    keys.trust(Path("laptop.pem"))      # which was copied from the laptop
    settings = keys.zenoh_settings()    # for a session of Zenoh
"""

import os
import re
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import make_private_folder, ownership_problem, write_private
from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.connect.link.header import ROBOT_NAME

VALID_DAYS = 730
MAX_DAYS = 36_500
MAX_TRUSTED = 1000
MAX_FILE_BYTES = 16_384
VALID_FROM = datetime(1970, 1, 1, tzinfo=timezone.utc)
"""Certificates are valid from then on, because the clock of a robot without a battery for it starts there."""
ORGANIZATION = "Robbie-MP"
KEY = "own.key"
CERTIFICATE = "own.pem"
TRUSTED = "trusted"
BUNDLE = "trusted.pem"
BEGIN = "-----BEGIN CERTIFICATE-----"


class KeysError(RobbieError, ValueError):
    """Keys or certificates cannot be made, read or used; the text says which, why, and what to do."""


class Certificate(NamedTuple):
    """The content of a certificate.

    Attributes:
        robot: the robot's name.
        fingerprint: SHA-256 of the authority's certificate. Compare it on both machines.
        expires: when it ends.
        file: where the authority's certificate is; it is public.
    """

    robot: str
    fingerprint: str
    expires: datetime
    file: Path


def default_folder() -> Path:
    """Return the folder of this user's keys: `robbie/keys` in $XDG_CONFIG_HOME, or in ~/.config."""
    base = os.environ.get("XDG_CONFIG_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".config") / "robbie" / "keys"


class Keys:
    """The keys in a folder.

    Args:
        folder: only this user may read it. It need not exist.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def make(self, robot: str, days: float = VALID_DAYS, *, replace: bool = False) -> Certificate:
        """Make key and certificate of this robot.

        Args:
            robot: its name: letters, digits, '-' and '_', at most 32.
            days: time until they expire.
            replace: forget keys that are there. Other robots must then trust the new ones.

        Raises:
            KeysError: the name or the time is wrong, there are keys already, or they cannot be written.
        """
        if not ROBOT_NAME.fullmatch(robot):
            raise KeysError(
                f"a robot's name has letters, digits, '-' and '_', and at most 32 characters; got {robot!r}"
            )
        if not 0 < days <= MAX_DAYS:
            raise KeysError(f"keys are valid for more than 0 and at most {MAX_DAYS} days; got {days:g}")
        if (self.folder / KEY).exists() and not replace:
            raise KeysError(
                f"there are keys in {self.folder} already, which other robots may trust; to make new ones "
                f"nevertheless: robbie keys new --replace"
            )
        return self._make(robot, _now() + timedelta(days=days))

    def own(self) -> Certificate:
        """Return the certificate of this robot.

        Raises:
            KeysError: there is none, or it cannot be read.
        """
        if not (self.folder / CERTIFICATE).exists():
            raise KeysError(f"there are no keys in {self.folder}; to make them: robbie keys new NAME")
        leaf = _read(self.folder / CERTIFICATE)
        return self._authority(self.folder / f"{_name_of(leaf)}.pem")

    def trust(self, file: Path) -> Certificate:
        """Let a robot connect from now on, whose public certificate is in a file.

        Args:
            file: what `make` wrote on the other robot: NAME.pem.

        Raises:
            KeysError: it is no such file, has expired, or another robot with that name is trusted.
        """
        found = self._authority(file)
        name = found.robot
        if found.expires <= _now():
            raise KeysError(
                f"{file}: {_expired(found)}; make new keys there: robbie keys new {name} --replace"
            )
        trusted = {one.robot: one for one in self.trusted()}
        if (self.folder / CERTIFICATE).exists() and self.own().robot == name:
            raise KeysError(f"{file} is of {name}, as this robot is called, too; give each its own name")
        if name in trusted and trusted[name].fingerprint != found.fingerprint:
            raise KeysError(
                f"a robot {name} with another key is trusted already; if it has made new keys, "
                f"first forget the old ones: robbie keys revoke {name}"
            )
        if len(trusted) >= MAX_TRUSTED:
            raise KeysError(f"{MAX_TRUSTED} robots are trusted already, which is the limit")
        self._write(self.folder / TRUSTED / f"{name}.pem", _read_text(file))
        self._write_bundle()
        return found._replace(file=self.folder / TRUSTED / f"{name}.pem")

    def trusted(self) -> list[Certificate]:
        """Return the certificates of the robots that may connect, by name.

        Raises:
            KeysError: one cannot be read.
        """
        return [self._authority(file) for file in sorted((self.folder / TRUSTED).glob("*.pem"))]

    def revoke(self, robot: str) -> None:
        """Let a robot no longer connect. Links that are open stay open until they end.

        Raises:
            KeysError: it is not trusted.
        """
        known = [one.robot for one in self.trusted()]
        if robot not in known:
            raise KeysError(f"{robot!r} is not trusted{did_you_mean(robot, known)}")
        (self.folder / TRUSTED / f"{robot}.pem").unlink()
        self._write_bundle()

    def zenoh_settings(self) -> dict[str, object]:
        """Return settings of Zenoh by their path, with which only trusted robots connect, over TLS.

        Addresses must begin with `tls/` or `quic/`; Zenoh then refuses others.

        Raises:
            KeysError: there are no keys, others can read them, or they have expired.
        """
        own = self.own()
        if own.expires <= _now():
            raise KeysError(
                f"the certificate in {self.folder} {_expired(own)}; to make a new one: "
                f"robbie keys new {own.robot} --replace"
            )
        for file, is_folder in ((self.folder, True), (self.folder / KEY, False)):
            try:
                problem = ownership_problem(file.stat(), folder=is_folder)
            except OSError as error:
                problem = f"cannot be read: {error.strerror}"
            if problem:
                raise KeysError(f"{file} {problem}; others could pretend to be {own.robot}")
        self._write_bundle()
        key, certificate = str(self.folder / KEY), str(self.folder / CERTIFICATE)
        settings: dict[str, object] = {
            "root_ca_certificate": str(self.folder / BUNDLE),
            "enable_mtls": True,
            "listen_private_key": key,
            "listen_certificate": certificate,
            "connect_private_key": key,
            "connect_certificate": certificate,
            # Addresses of robots change; the authority alone says which robot it is.
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        }
        tls = {f"transport/link/tls/{name}": value for name, value in settings.items()}
        return {"transport/link/protocols": ["tls", "quic"], **tls}

    def _make(self, robot: str, expires: datetime) -> Certificate:
        made = _sign(robot, expires)
        self._remove_own()
        # The certificate comes last: without it, there are no keys.
        self._write(self.folder / f"{robot}.pem", made.authority)
        self._write(self.folder / KEY, made.key)
        self._write(self.folder / CERTIFICATE, made.certificate)
        self._write_bundle()
        return self.own()

    def _remove_own(self) -> None:
        if (self.folder / CERTIFICATE).exists():
            self.own().file.unlink(missing_ok=True)
            (self.folder / CERTIFICATE).unlink()

    def _authority(self, file: Path) -> Certificate:
        text = _read_text(file)
        authority = _read(file)
        name = _name_of(authority)
        if not _is_authority(authority) or text.count(BEGIN) != 1 or not ROBOT_NAME.fullmatch(name):
            raise KeysError(f"{file} is no certificate that `robbie keys new` made to be given to others")
        return Certificate(name, _fingerprint(authority), authority.not_valid_after_utc, file)

    def _write_bundle(self) -> None:
        own = [self.own().file] if (self.folder / CERTIFICATE).exists() else []
        text = "".join(_read_text(file) for file in (*own, *(one.file for one in self.trusted())))
        bundle = self.folder / BUNDLE
        if not bundle.exists() or bundle.read_text() != text:
            self._write(bundle, text)

    def _write(self, file: Path, text: str) -> None:
        """Replace a file at once, so that no reader sees half of it."""
        try:
            folder = file.parent.resolve()
            make_private_folder(folder)
            write_private(folder / file.name, text, durably=True)
        except OSError as error:
            raise KeysError(f"cannot write {file}: {error.strerror}") from error


class _Made(NamedTuple):
    """Texts in PEM."""

    key: str
    certificate: str
    authority: str


def _sign(robot: str, expires: datetime) -> _Made:
    """Make an authority, have it sign the certificate of a robot, and forget its key."""
    x509 = _library()
    from cryptography.hazmat.primitives import hashes, serialization  # noqa: PLC0415 - an extra
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID  # noqa: PLC0415

    def named(organization: str) -> Any:
        pairs = ((NameOID.ORGANIZATION_NAME, organization), (NameOID.COMMON_NAME, robot))
        return x509.Name([x509.NameAttribute(kind, text) for kind, text in pairs])

    def usage(*, signs_certificates: bool) -> Any:
        return x509.KeyUsage(
            digital_signature=not signs_certificates, key_cert_sign=signs_certificates, crl_sign=False,
            content_commitment=False, key_encipherment=False, data_encipherment=False, key_agreement=False,
            encipher_only=False, decipher_only=False,
        )  # fmt: skip

    authority_key, key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    authority_id = x509.SubjectKeyIdentifier.from_public_key(authority_key.public_key())
    signed_by = x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(authority_id)
    issuer = named(f"{ORGANIZATION} authority")

    def builder(subject: Any, key: Any) -> Any:
        return x509.CertificateBuilder(
            issuer, subject, key.public_key(), x509.random_serial_number(), VALID_FROM, expires
        )

    authority = (
        builder(issuer, authority_key)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage(signs_certificates=True), critical=True)
        .add_extension(authority_id, critical=False)
        .sign(authority_key, hashes.SHA256())
    )
    both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    certificate = (
        builder(named(ORGANIZATION), key)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(both), critical=False)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(robot)]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(signed_by, critical=False)
        .sign(authority_key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return _Made(
        private.decode(), certificate.public_bytes(pem).decode(), authority.public_bytes(pem).decode()
    )


def _library() -> Any:
    try:
        from cryptography import x509  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise KeysError("keys need the library cryptography: pip install cryptography") from error
    return x509


def _read_text(file: Path) -> str:
    try:
        with open_regular(file) as opened:
            content = opened.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise KeysError(f"cannot read {file}: {error.strerror}") from error
    if len(content) > MAX_FILE_BYTES:
        raise KeysError(f"{file} is no certificate: it has more than {MAX_FILE_BYTES} bytes")
    if b"PRIVATE KEY" in content:
        raise KeysError(f"{file} has a private key, which nobody else may have; give others NAME.pem instead")
    return content.decode("ascii", "replace")


def _read(file: Path) -> Any:
    text = _read_text(file)
    try:
        return _library().load_pem_x509_certificate(text.encode())
    except ValueError as error:
        raise KeysError(f"{file} is no certificate in PEM") from error


def _is_authority(certificate: Any) -> bool:
    """Return whether a certificate is of an authority as `_sign` makes it, signed by itself."""
    x509 = _library()
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415 - an extra
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415

    try:
        key = certificate.public_key()
        constraints = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        certificate.verify_directly_issued_by(certificate)
    except (ValueError, TypeError, InvalidSignature, x509.ExtensionNotFound):
        return False
    is_curve = isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP256R1)
    return is_curve and constraints.ca and constraints.path_length == 0


def _name_of(certificate: Any) -> str:
    from cryptography.x509.oid import NameOID  # noqa: PLC0415 - an extra

    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if len(names) == 1 else ""


def _fingerprint(certificate: Any) -> str:
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415 - an extra

    return " ".join(re.findall("....", certificate.fingerprint(hashes.SHA256()).hex()))


def _expired(certificate: Certificate) -> str:
    return f"expired on {certificate.expires:%Y-%m-%d}"


def _now() -> datetime:
    return datetime.now(timezone.utc)
