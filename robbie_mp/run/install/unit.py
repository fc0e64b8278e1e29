"""The systemd unit of a robot: systemd.service(5), systemd.exec(5)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.base.visible_text import one_line
from robbie_mp.run.doctor.needs import Needs
from robbie_mp.run.profile.model import Profile

UNITS = Path("etc/systemd/system")
WATCHDOG_S = 10
START_LIMIT_S = 300
STOP_MARGIN_S = 10
SHARED_MEMORY_MARGIN = 1.25
"""Other programs use /dev/shm, too."""
MEBIBYTE = 1 << 20
CONTROL = re.compile(r"[\x00-\x1f\x7f]")
TEMPLATE = """\
# Written by `robbie install {profile}`; run it again when the profile has changed.
[Unit]
Description=Robot {profile} (Robbie-MP)
After=systemd-udevd.service local-fs.target
StartLimitIntervalSec=120
StartLimitBurst=5

[Service]
Type=notify
NotifyAccess=main
User={user}
{groups}WorkingDirectory={folder}
EnvironmentFile=-/etc/robbie/{name}.env
{prepare}ExecStart={command}
# Exit code 0: the run has ended as it should. 2: the profile is wrong, which another start cannot fix.
# 3: the run has ended in order, but a module had been DEGRADED.
Restart=on-failure
RestartSec=1
RestartPreventExitStatus=2 3
# The supervisor tells that it does not hang. If it does, systemd kills it, and with it all modules.
WatchdogSec={watchdog_s}
WatchdogSignal=SIGKILL
TimeoutStartSec={start_s}
# The supervisor stops its modules in order, so only it gets SIGTERM.
KillMode=mixed
TimeoutStopSec={stop_s}
# The kernel ends a module that takes too much memory, and the supervisor restarts it; the others go on.
OOMPolicy=continue
OOMScoreAdjust=-500
LimitNOFILE={descriptors}
LimitMEMLOCK=infinity
{realtime}
[Install]
WantedBy=multi-user.target
"""


@dataclass(frozen=True)
class Installed:
    """One file to install.

    Attributes:
        path: where it belongs, relative to the root of the file system.
        text: its content.
    """

    path: Path
    text: str


def unit_name(profile: str) -> str:
    """Return the name of a profile's unit, without `.service`."""
    return "robbie-" + re.sub(r"[^A-Za-z0-9_.-]+", "-", profile)


def unit(
    profile: Profile,
    command: Sequence[str],
    user: str,
    groups: Sequence[str] = (),
    shared_memory_bytes: int | None = None,
) -> Installed:
    """Return the unit that runs a profile.

    Args:
        profile: the profile, merged.
        command: the words of the command that runs it, the first with its whole path.
        user: who runs it.
        groups: further groups of the user, for the access to devices.
        shared_memory_bytes: present size of /dev/shm; if it is too small, the unit makes it larger. None:
            leave it.
    """
    needs = Needs.of(profile)
    wanted = int(needs.limit_bytes * SHARED_MEMORY_MARGIN)
    prepare = ""
    if shared_memory_bytes is not None and shared_memory_bytes < wanted:
        size = -(-wanted // MEBIBYTE)
        prepare = f"ExecStartPre=+/bin/mount -o remount,size={size}M /dev/shm\n"
    name = unit_name(profile.name)
    graces_s = sum(module.stop_grace_s for module in profile.modules)
    text = TEMPLATE.format(
        profile=_one_line(profile.name),
        name=name.removeprefix("robbie-"),
        user=user,
        groups=f"SupplementaryGroups={' '.join(groups)}\n" if groups else "",
        folder=_specifiers(str(profile.workspace)),
        prepare=prepare,
        command=" ".join(quoted(word) for word in command),
        watchdog_s=WATCHDOG_S,
        start_s=START_LIMIT_S,
        stop_s=round(graces_s) + STOP_MARGIN_S,
        descriptors=max(2 * needs.descriptors, 1024),
        realtime=f"LimitRTPRIO={needs.realtime_priority}\n" if needs.realtime_priority else "",
    )
    return Installed(UNITS / f"{name}.service", text)


def quoted(word: str) -> str:
    """Return a word of a command as systemd reads it back."""
    escaped = word.replace("\\", "\\\\").replace('"', '\\"')
    escaped = CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", escaped)
    return f'"{_specifiers(escaped).replace("$", "$$")}"'


def _specifiers(text: str) -> str:
    return text.replace("%", "%%")


def _one_line(text: str) -> str:
    return one_line(_specifiers(text))
