"""Hosts on this machine that reach one another only through a network as bad as you set.

Each host is a network namespace with one device, `radio0`; they share a switch in a further namespace. The
kernel limits the rate (tc, token bucket) and loses packets (iptables, statistic); a program delays frames.
Everything ends with this process, however it ends.

    with Network("robot", "laptop") as network:
        network.set(Conditions(bandwidth_bit_per_s=5e6, loss=0.02, delay_s=0.1, jitter_s=0.05))
        robot = network.host("robot").popen("robbie", "run", "rescue")
        network.cut()
"""

import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from typing_extensions import Self

from tools.test_network.namespace import Namespace

TOOLS = ("ip", "tc", "iptables", "iptables-restore", "nsenter")
TUN = Path("/dev/net/tun")
PREFIX = "10.77.0."
DEVICE = "radio0"
MIN_BURST_BYTES = 3200
"""Two frames: the least that the token bucket must hold to send at all."""
BURST_S = 0.005
FILTER = (
    "*filter\n"
    ":cut - [0:0]\n"
    ":loss - [0:0]\n"
    f"-A INPUT -i {DEVICE} -j cut\n"
    f"-A INPUT -i {DEVICE} -j loss\n"
    "COMMIT\n"
)


class NoTestNetwork(RuntimeError):
    """This machine does not allow hosts with separate networks. The text says why."""


@dataclass(frozen=True)
class NetworkConditions:
    """The network's faults; each direction has the same ones, and its own random numbers.

    Attributes:
        bandwidth_bit_per_s: rate at which each host receives, with the headers of Ethernet.
        queue_s: time that packets wait at most for the bandwidth; those that would wait longer are lost.
        loss: probability that a packet is lost on its way, 0 to 1.
        delay_s: time on the way, without the wait for the bandwidth; half of the round trip.
        jitter_s: greatest difference from `delay_s`.
        reorders: packets overtake one another, as they do between several paths. On one radio they do not.
    """

    bandwidth_bit_per_s: float = math.inf
    queue_s: float = 0.1
    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    reorders: bool = False

    def __post_init__(self) -> None:
        if not (self.bandwidth_bit_per_s > 0.0 and self.queue_s > 0.0 and 0.0 <= self.loss <= 1.0):
            raise ValueError(f"bandwidth and queue must be positive, and loss between 0 and 1: {self}")
        if not 0.0 <= self.jitter_s <= self.delay_s < math.inf:
            raise ValueError(f"the jitter must be between 0 and the delay: {self}")


PERFECT = NetworkConditions()


class Host:
    """One host of the network.

    Attributes:
        name: as you named it.
        address: its IPv4 address.
    """

    def __init__(self, name: str, address: str, namespace: Namespace):
        self.name, self.address, self._namespace = name, address, namespace

    def command(self, *command: str) -> list[str]:
        """Return a command that runs a command on this host, with the same process id."""
        return self._namespace.command(*command)

    def popen(self, *command: str, **options: Any) -> "subprocess.Popen[Any]":
        """Start a program on this host; options as for `subprocess.Popen`."""
        return subprocess.Popen(self.command(*command), **options)

    def entered(self) -> contextlib.AbstractContextManager[None]:
        """Have the calling thread make its sockets on this host; they stay there."""
        return self._namespace.entered()


class Network:
    """The hosts and what is between them, inside the `with` block.

    Args:
        names: of the hosts, at most 200.
    """

    def __init__(self, *names: str):
        self._names = names
        self._kept = contextlib.ExitStack()
        self._forwarder: subprocess.Popen[str] | None = None
        self._changing = threading.Lock()

    def __enter__(self) -> Self:
        """Make it.

        Raises:
            NoTestNetwork: this machine does not allow it.
        """
        if os.geteuid() != 0:
            raise NoTestNetwork("only root can make network namespaces")
        if missing := [tool for tool in TOOLS if shutil.which(tool) is None]:
            raise NoTestNetwork(
                f"there is no {', '.join(missing)}; install iproute2, iptables and util-linux"
            )
        try:
            self._make()
        except (OSError, subprocess.CalledProcessError) as error:
            self._kept.close()
            detail = getattr(error, "stderr", None) or error
            raise NoTestNetwork(f"cannot make the network: {detail}") from error
        except BaseException:
            self._kept.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove it. Programs that still run on a host keep that host, alone."""
        self._kept.close()

    def host(self, name: str) -> Host:
        """Return a host."""
        return self._hosts[name]

    def set(self, conditions: NetworkConditions) -> None:
        """Set what the network does from now on. What was cut stays cut."""
        for index, host in enumerate(self._hosts.values()):
            self._limit(f"port{index}", conditions)
            rule = f"-A loss -m statistic --mode random --probability {conditions.loss:.6f} -j DROP\n"
            rules = f"*filter\n:loss - [0:0]\n{rule * (conditions.loss > 0)}COMMIT\n"
            _run(host.command("iptables-restore", "--noflush"), rules)
        self.delay(conditions)

    def delay(self, conditions: NetworkConditions) -> None:
        """Set the delay alone; from one delay to another, this takes effect at once."""
        if not conditions.delay_s:
            _batch(self._switch, *(f"link set port{i} master hub" for i in range(len(self._names))))
            return
        if self._forwarder is None:
            self._forwarder = self._start_forwarder()
        names = ("delay_s", "jitter_s", "reorders")
        self._tell(self._forwarder, json.dumps({name: getattr(conditions, name) for name in names}))
        _batch(self._switch, *(f"link set port{i} master delay{i}" for i in range(len(self._names))))

    def cut(self, *names: str) -> None:
        """Have these hosts receive nothing, all hosts by default. They notice only the silence."""
        self._filter("-A", names)

    def restore(self, *names: str) -> None:
        """End cuts of these hosts, of all by default."""
        self._filter("-F", names)

    @contextmanager
    def flapping(self, up_s: float, down_s: float) -> Iterator[None]:
        """Cut and restore the network again and again; at the end it is fixed."""
        ended = threading.Event()

        def flap() -> None:
            while not ended.wait(up_s):
                self.cut()
                ended.wait(down_s)
                self.restore()

        thread = threading.Thread(target=flap, name="flapping")
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _make(self) -> None:
        self._switch = self._namespace()
        self._hosts: dict[str, Host] = {}
        _batch(self._switch, "link add hub type bridge mcast_snooping 0", "link set hub up")
        for index, name in enumerate(self._names):
            namespace = self._namespace()
            address = f"{PREFIX}{index + 1}"
            self._hosts[name] = Host(name, address, namespace)
            _batch(
                self._switch,
                f"link add port{index} type veth peer name {DEVICE} netns {namespace.path}",
                f"link set port{index} master hub",
                f"link set port{index} up",
            )
            _batch(
                namespace,
                "link set lo up",
                f"link set {DEVICE} up",
                f"address add {address}/24 broadcast + dev {DEVICE}",
                f"route add 224.0.0.0/4 dev {DEVICE}",
            )
            _run(namespace.command("iptables-restore", "--noflush"), FILTER)

    def _namespace(self) -> Namespace:
        made = Namespace()
        self._kept.callback(made.close)
        return made

    def _limit(self, port: str, conditions: NetworkConditions) -> None:
        tc = self._switch.command("tc", "qdisc")
        rate = conditions.bandwidth_bit_per_s
        if math.isinf(rate):
            subprocess.run(
                [*tc, "del", "dev", port, "root"], capture_output=True, check=False
            )  # if there is one
            return
        burst = max(MIN_BURST_BYTES, int(rate / 8 * BURST_S))
        limit = burst + int(rate / 8 * conditions.queue_s)
        bucket = ["tbf", "rate", f"{rate:.0f}bit", "burst", f"{burst}", "limit", f"{limit}"]
        _run([*tc, "replace", "dev", port, "root", *bucket])

    def _start_forwarder(self) -> "subprocess.Popen[str]":
        if not TUN.exists():
            raise NoTestNetwork(f"there is no {TUN}")
        taps = [f"tap{index}" for index in range(len(self._names))]
        forwarder = subprocess.Popen(
            self._switch.command(sys.executable, "-m", "tools.test_network.delay", *taps),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        self._kept.callback(forwarder.communicate)
        assert forwarder.stdout is not None
        if forwarder.stdout.readline() != "ready\n":
            raise NoTestNetwork("the program that delays frames did not start")
        for index, tap in enumerate(taps):
            _batch(
                self._switch,
                f"link add delay{index} type bridge mcast_snooping 0",
                f"link set delay{index} up",
                f"link set {tap} master delay{index}",
                f"link set {tap} txqueuelen 10000",
                f"link set {tap} up",
            )
        return forwarder

    def _tell(self, forwarder: "subprocess.Popen[str]", line: str) -> None:
        assert forwarder.stdin is not None
        assert forwarder.stdout is not None
        forwarder.stdin.write(f"{line}\n")
        forwarder.stdin.flush()
        if forwarder.stdout.readline() != "set\n":
            raise NoTestNetwork("the program that delays frames has ended")

    def _filter(self, action: str, names: tuple[str, ...]) -> None:
        with self._changing:
            for name in names or self._names:
                target = ["-j", "DROP"] if action == "-A" else []
                _run(self._hosts[name].command("iptables", action, "cut", *target))


def _batch(namespace: Namespace, *lines: str) -> None:
    _run(namespace.command("ip", "-batch", "-"), "\n".join(lines) + "\n")


def _run(command: list[str], given: str = "") -> None:
    subprocess.run(command, input=given, capture_output=True, text=True, check=True)
