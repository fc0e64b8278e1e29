"""Permissions: the folder for runs, serial ports, and whether systemd removes shared memory at log-out."""

import grp
import os
import pwd
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from robbie_mp.run.doctor.finding import Finding, fail, ok, warn
from robbie_mp.run.run_directory import base_folders, privacy_problem

SERIAL_PORTS = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*")
LOGIN_SETTINGS = ("/usr/lib/systemd", "/etc/systemd", "/run/systemd")
FIRST_LOGIN_UID = 1000
"""systemd does not remove shared memory of system users, which have smaller numbers."""


def look_at_permissions() -> Iterator[Finding]:
    """Judge what this user may do on this machine."""
    yield check_run_folder(base_folders()[0], os.environ.get("XDG_RUNTIME_DIR"))
    ports = sorted(port for pattern in SERIAL_PORTS for port in Path("/dev").glob(pattern))
    yield check_serial_ports(
        {str(port): os.access(port, os.R_OK | os.W_OK) for port in ports},
        _group_of(ports[0]) if ports else "dialout",
        _own_groups(),
    )
    if Path("/run/systemd/system").is_dir():
        lingers = Path("/var/lib/systemd/linger", _user_name()).exists()
        yield check_removal(os.geteuid(), login_setting("RemoveIPC"), lingers=lingers)


def login_setting(key: str, folders: Sequence[str] = LOGIN_SETTINGS) -> str | None:
    """Return a setting of systemd-logind, None if no file sets it; see logind.conf(5)."""
    files = [Path(folder, "logind.conf") for folder in folders]
    files += sorted(
        (file for folder in folders for file in Path(folder, "logind.conf.d").glob("*.conf")),
        key=lambda file: file.name,
    )
    value = None
    for file in files:
        try:
            lines = file.read_text(errors="replace").splitlines()
        except OSError:
            continue
        for line in lines:
            name, equals, text = line.partition("=")
            if equals and name.strip() == key:
                value = text.strip()
    return value


def _user_name() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())  # in containers, users may have no names


def _group_of(file: Path) -> str:
    try:
        return grp.getgrgid(file.stat().st_gid).gr_name
    except (OSError, KeyError):
        return "dialout"


def _own_groups() -> frozenset[str]:
    names = set()
    for number in {os.getegid(), *os.getgroups()}:
        try:
            names.add(grp.getgrgid(number).gr_name)
        except KeyError:
            continue  # the group has no name
    return frozenset(names)


def check_run_folder(base: Path, runtime: str | None) -> Finding:
    """Judge the folder for runs.

    Args:
        base: the folder; it need not exist yet.
        runtime: the value of XDG_RUNTIME_DIR.
    """
    try:
        problem = privacy_problem(base)
    except OSError:
        is_writable = os.access(base.parent, os.W_OK | os.X_OK)
        problem = "" if is_writable else f"cannot be created in {base.parent}"
    else:
        if not problem and not os.access(base, os.W_OK | os.X_OK):
            problem = "cannot be written to"
    if problem:
        return fail("run folder", f"{base} {problem}", "remove it, or set XDG_RUNTIME_DIR")
    if runtime and not base.is_relative_to(runtime):
        return warn(
            "run folder",
            f"{base}, because XDG_RUNTIME_DIR={runtime} is not a folder of this user",
            "unset XDG_RUNTIME_DIR, or log in as this user instead of using sudo or su",
        )
    return ok("run folder", str(base))


def check_serial_ports(ports: Mapping[str, bool], group: str, groups: frozenset[str]) -> Finding:
    """Judge the serial ports, which connect laser range finders and drive bases.

    Args:
        ports: whether this user may read and write each.
        group: the group that owns them.
        groups: the groups of this user.
    """
    closed = [port for port, is_open in ports.items() if not is_open]
    if closed and group not in groups:
        advice = f"sudo usermod -aG {group} $USER, then log in again"
        return warn("serial ports", f"{', '.join(closed)} may not be opened", advice)
    if closed:
        advice = f"see ls -l {closed[0]}; a udev rule may give it to group {group}"
        return warn("serial ports", f"{', '.join(closed)} may not be opened", advice)
    if not ports:
        is_member = "is" if group in groups else "is not"
        return ok("serial ports", f"there are none; this user {is_member} in group {group}, which owns them")
    return ok("serial ports", f"{', '.join(ports)} may be opened")


def check_removal(uid: int, setting: str | None, *, lingers: bool) -> Finding:
    """Judge whether systemd removes shared memory when its user logs out (logind.conf(5), RemoveIPC).

    Args:
        uid: the user.
        setting: the value of RemoveIPC; None: the default, yes.
        lingers: whether systemd keeps this user's services running without a login.
    """
    removes = (setting or "yes").lower() in ("yes", "true", "on", "1")
    if uid < FIRST_LOGIN_UID or not removes or lingers:
        return ok("log-out", "does not affect shared memory")
    return warn(
        "log-out",
        "when this user's last session ends, systemd removes the shared memory of running robots",
        "loginctl enable-linger, or RemoveIPC=no in /etc/systemd/logind.conf",
    )
