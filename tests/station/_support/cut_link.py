"""A network link that you can cut. The robot is at this end; at the other end, a browser runs in a namespace.

You need the right to make namespaces and links (CAP_NET_ADMIN, CAP_SYS_ADMIN), and the programs of iproute2
and util-linux. See ip-link(8), veth(4) and network_namespaces(7).
"""

import os
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NETWORK, HERE, THERE = "198.18.77.0/30", "198.18.77.1", "198.18.77.2"
"""From the range reserved for benchmarks of network devices (RFC 2544), which no real network uses."""
PROGRAMS = ("ip", "unshare", "nsenter")


def why_no_link() -> str:
    """Return why this machine allows no link; '' if it does."""
    missing = [program for program in PROGRAMS if shutil.which(program) is None]
    if missing:
        return f"{', '.join(missing)} not found"
    routes = subprocess.run(["ip", "route", "show", "root", NETWORK], capture_output=True, check=True)
    if routes.stdout:
        return f"the network {NETWORK} is somebody's here"
    name = f"rb{os.getpid()}t"
    tried = subprocess.run(
        ["unshare", "--net", "ip", "link", "add", name, "type", "veth"],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"no network namespace: {tried.stderr.strip()}" if tried.returncode else ""


class CutLink:
    """The link. At first, it is up.

    Args:
        keeper: a process in the other namespace; the namespace ends with it.
    """

    def __init__(self, keeper: int):
        self._enter = ["nsenter", f"--net=/proc/{keeper}/ns/net", "--"]
        self._name = f"rb{os.getpid()}"
        _run("ip", "link", "add", self._name, "type", "veth", "peer", "name", "eth0", "netns", str(keeper))
        _run("ip", "address", "add", f"{HERE}/30", "dev", self._name)
        _run(*self._enter, "ip", "address", "add", f"{THERE}/30", "dev", "eth0")
        _run(*self._enter, "ip", "link", "set", "lo", "up")
        _run(*self._enter, "ip", "link", "set", "eth0", "up")
        self.restore()

    def cut(self) -> None:
        """Take the link down."""
        _run("ip", "link", "set", self._name, "down")

    def restore(self) -> None:
        """Bring the link up."""
        _run("ip", "link", "set", self._name, "up")

    def write_starter(self, program: str, file: Path) -> Path:
        """Write a script that starts a program at the other end, and return its path."""
        file.write_text(f'#!/bin/sh\nexec {shlex.join(self._enter)} {shlex.quote(program)} "$@"\n')
        file.chmod(0o755)
        return file


@contextmanager
def cut_link() -> Iterator[CutLink]:
    """Make a link. At the end, remove it and end all processes at its other end."""
    # It reads a pipe of this process, and so ends with this process.
    keeper = subprocess.Popen(
        ["unshare", "--net", "sh", "-c", "echo; exec cat"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert keeper.stdin and keeper.stdout
    try:
        keeper.stdout.readline()
        yield CutLink(keeper.pid)  # the kernel removes the link with the namespace
    finally:
        keeper.stdin.close()
        keeper.wait()
        keeper.stdout.close()


def _run(*command: str) -> None:
    subprocess.run(command, check=True)
