"""Who may do what: folders of runs, serial ports, and what happens to shared memory after a log-out."""

import grp
import os
import pwd
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from robbie_mp.doctor.finding import Finding, fail, ok, warn
from robbie_mp.run.run_directory import base_folders, privacy_problem

SERIAL_PORTS = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*")
LOGIN_SETTINGS = ("/usr/lib/systemd", "/etc/systemd", "/run/systemd")
FIRST_LOGIN_UID = 1000
"""systemd removes nothing of system users, whose numbers are smaller."""


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
    """Return a setting of systemd-logind, None if no file has it; see logind.conf(5)."""
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
        return str(os.geteuid())  # as in containers, whose users have no names


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
            continue  # it has no name
    return frozenset(names)


def check_run_folder(base: Path, runtime: str | None) -> Finding:
    """Judge the folder in which runs make theirs.

    Args:
        base: that folder; it need not be there yet.
        runtime: the variable XDG_RUNTIME_DIR.
    """
    try:
        problem = privacy_problem(base)
    except OSError:
        is_writable = os.access(base.parent, os.W_OK | os.X_OK)
        problem = "" if is_writable else f"cannot be made in {base.parent}"
    else:
        if not problem and not os.access(base, os.W_OK | os.X_OK):
            problem = "cannot be written to"
    if problem:
        return fail("run folder", f"{base} {problem}", "remove it, or set XDG_RUNTIME_DIR")
    if runtime and not base.is_relative_to(runtime):
        return warn(
            "run folder",
            f"{base}, for XDG_RUNTIME_DIR={runtime} is no folder of this user",
            "unset XDG_RUNTIME_DIR, or log in as this user rather than by sudo or su",
        )
    return ok("run folder", str(base))


def check_serial_ports(ports: Mapping[str, bool], group: str, groups: frozenset[str]) -> Finding:
    """Judge the serial ports, as of laser range finders and bases.

    Args:
        ports: whether each may be read and written.
        group: whose they are.
        groups: those of this user.
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
        return ok("serial ports", f"there is none; this user {is_member} in group {group}, which owns them")
    return ok("serial ports", f"{', '.join(ports)} may be opened")


def check_removal(uid: int, setting: str | None, *, lingers: bool) -> Finding:
    """Judge whether systemd removes shared memory when its user logs out (logind.conf(5), RemoveIPC).

    Args:
        uid: the user.
        setting: RemoveIPC as it is set; None: the default, yes.
        lingers: whether systemd keeps this user's services without a login.
    """
    removes = (setting or "yes").lower() in ("yes", "true", "on", "1")
    if uid < FIRST_LOGIN_UID or not removes or lingers:
        return ok("log-out", "leaves shared memory alone")
    return warn(
        "log-out",
        "when this user has logged out everywhere, systemd removes the shared memory of robots that run",
        "loginctl enable-linger, or RemoveIPC=no in /etc/systemd/logind.conf",
    )
