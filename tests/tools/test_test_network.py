"""The bad network does what is set, by measurement, and nothing of it outlives its process."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests._support.robot import wait_until
from tools.test_network.delay import Delay
from tools.test_network.network import PERFECT, Host, Network, NetworkConditions, NoTestNetwork

LIMIT_S = 10.0
SO_RCVBUFFORCE = 33
"""Sets a receive buffer beyond the limit for all programs (socket(7)). Python does not name it."""
SILENCE_S = 0.3
"""After this time without a packet, no further one comes."""
FIRST_S = 1.0
"""The first packet also waits for the other host's Ethernet address."""


@contextmanager
def datagram_sockets(*hosts: Host) -> Iterator[list[socket.socket]]:
    with ExitStack() as opened:
        made = []
        for host in hosts:
            with host.entered():
                made.append(opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)))
            made[-1].bind((host.address, 0))
        yield made


def arrivals(network: Network, count: int, pause_s: float = 0.0) -> list[tuple[int, float]]:
    """Send numbered packets from the robot to the laptop; return number and delay of all that arrive."""
    with datagram_sockets(network.host("robot"), network.host("laptop")) as (sender, receiver):
        # Every packet fits, even if the receiver gets no processor meanwhile.
        receiver.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 22)
        receiver.settimeout(FIRST_S)
        sent_s: list[float] = []
        seen: list[tuple[int, float]] = []

        def receive() -> None:
            try:
                while True:
                    number = int(receiver.recv(100))
                    seen.append((number, time.monotonic() - sent_s[number]))
                    receiver.settimeout(SILENCE_S)
            except TimeoutError:
                pass

        thread = threading.Thread(target=receive)
        thread.start()
        for number in range(count):
            sent_s.append(time.monotonic())
            sender.sendto(b"%d" % number, receiver.getsockname())
            time.sleep(pause_s)
        thread.join()
    return seen


def tcp_bit_per_s(network: Network, duration_s: float) -> float:
    """Return the rate of one TCP connection from the robot to the laptop."""
    robot, laptop = network.host("robot"), network.host("laptop")
    with ExitStack() as opened:
        with laptop.entered():
            listener = opened.enter_context(socket.create_server((laptop.address, 0)))
        with robot.entered():
            sender = opened.enter_context(socket.create_connection(listener.getsockname()))
        receiver = opened.enter_context(listener.accept()[0])

        def send() -> None:
            try:
                while True:
                    sender.send(bytes(1 << 16))
            except OSError:
                pass  # the receiver has enough

        thread = threading.Thread(target=send)
        thread.start()
        receiver.recv(1)
        started_s, size = time.monotonic(), 0
        while (passed_s := time.monotonic() - started_s) < duration_s:
            size += len(receiver.recv(1 << 16))
        receiver.close()
        with suppress(OSError):  # the receiver's end may have closed it
            sender.shutdown(socket.SHUT_RDWR)
        thread.join()
    return size * 8 / passed_s


def test_one_packet_in_five_is_lost_when_this_is_set(network: Network) -> None:
    network.set(NetworkConditions(loss=0.2))
    share = len(arrivals(network, 1500)) / 1500
    assert 0.75 < share < 0.85  # five standard deviations
    network.set(PERFECT)
    assert len(arrivals(network, 50)) == 50


@pytest.mark.alone  # it measures delays
def test_delay_varies_within_its_jitter_and_keeps_the_order(network: Network) -> None:
    arrivals(network, 1)  # now the hosts know each other's Ethernet addresses
    network.set(NetworkConditions(delay_s=0.1, jitter_s=0.05))
    seen = arrivals(network, 500, pause_s=0.003)
    delays_s = [delay_s for _, delay_s in seen]
    assert [number for number, _ in seen] == list(range(500))
    assert min(delays_s) >= 0.05
    assert sorted(delays_s)[450] < 0.16  # the others may wait for a processor
    assert max(delays_s) - min(delays_s) > 0.05
    network.set(PERFECT)
    assert sorted(delay_s for _, delay_s in arrivals(network, 21))[10] < 0.01


def test_packets_overtake_one_another_only_when_this_is_set(network: Network) -> None:
    network.set(NetworkConditions(delay_s=0.05, jitter_s=0.04, reorders=True))
    numbers = [number for number, _ in arrivals(network, 50)]
    assert sorted(numbers) == list(range(50))
    assert numbers != sorted(numbers)


def test_a_tcp_connection_gets_the_bandwidth_and_no_more(network: Network) -> None:
    assert tcp_bit_per_s(network, 0.2) > 50e6
    network.set(NetworkConditions(bandwidth_bit_per_s=5e6))
    assert 4e6 < tcp_bit_per_s(network, 1.0) < 5.5e6  # at the start the bucket is full


def test_nothing_arrives_while_the_network_is_cut(network: Network) -> None:
    network.cut()
    assert arrivals(network, 20) == []
    network.restore()
    assert len(arrivals(network, 20)) == 20


def test_a_flapping_network_loses_the_packets_of_its_bad_times(network: Network) -> None:
    with network.flapping(up_s=0.05, down_s=0.05):
        seen = len(arrivals(network, 200, pause_s=0.002))
    assert 20 < seen < 180
    assert len(arrivals(network, 20)) == 20


def test_multicast_reaches_the_other_host(network: Network) -> None:
    group = ("224.0.0.224", 7446)
    with datagram_sockets(network.host("robot")) as (sender,), ExitStack() as opened:
        laptop = network.host("laptop")
        with laptop.entered():
            receiver = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        receiver.bind(group)
        wanted = socket.inet_aton(group[0]) + socket.inet_aton(laptop.address)
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, wanted)
        receiver.settimeout(SILENCE_S)

        def arrives() -> bool:
            """The first datagrams may be lost, as anywhere."""
            sender.sendto(b"who is there?", group)
            with suppress(TimeoutError):
                return receiver.recv(100) == b"who is there?"
            return False

        wait_until(arrives, LIMIT_S)


def test_programs_run_on_their_host(network: Network) -> None:
    robot = network.host("robot")
    shown = subprocess.run(robot.command("ip", "-br", "address"), capture_output=True, text=True, check=True)
    assert robot.address in shown.stdout
    assert network.host("laptop").address not in shown.stdout


@pytest.mark.usefixtures("network")  # which skips where there can be none
def test_nothing_is_left_of_the_network_of_a_killed_process() -> None:
    script = (
        "import os, signal\n"
        "from tools.test_network.network import Network, NetworkConditions\n"
        "network = Network('robot', 'laptop').__enter__()\n"
        "network.set(NetworkConditions(delay_s=0.01))\n"
        "with network.host('robot').entered():\n"
        "    print(os.readlink('/proc/thread-self/ns/net'))\n"
        "print(os.readlink(f'/proc/{network._forwarder.pid}/ns/net'), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    namespaces = set(done.stdout.split())
    assert len(namespaces) == 2
    deadline_s = time.monotonic() + LIMIT_S
    while used := namespaces & namespaces_in_use():
        assert time.monotonic() < deadline_s, used
        time.sleep(0.01)


def namespaces_in_use() -> set[str]:
    """Return the network namespaces that any process is in or keeps open."""
    found = set()
    for process in Path("/proc").glob("[0-9]*"):
        for link in (process / "ns" / "net", *process.glob("fd/*")):
            with suppress(OSError):  # the process has ended
                found.add(os.readlink(link))
    return found


def test_who_may_not_make_a_network_is_told_why(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("os.geteuid", lambda: 1000)
        with pytest.raises(NoTestNetwork, match="only root"):
            Network("robot").__enter__()
    with monkeypatch.context() as patch:
        patch.setattr("os.geteuid", lambda: 0)
        patch.setenv("PATH", "")
        with pytest.raises(NoTestNetwork, match="there is no ip, tc"):
            Network("robot").__enter__()


@pytest.mark.parametrize(
    "wrong",
    [{"bandwidth_bit_per_s": 0.0}, {"queue_s": 0.0}, {"loss": 1.1}, {"jitter_s": 0.1}, {"delay_s": -1.0}],
)
def test_conditions_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        NetworkConditions(**wrong)  # type: ignore[arg-type]


@given(
    jitter_s=st.floats(0.0, 0.5),
    pauses_s=st.lists(st.floats(0.0, 3.0) | st.floats(0.0, 1e-3), max_size=50),
    seed=st.integers(),
)
def test_slowly_varying_delay_stays_in_its_bounds_and_never_reorders(
    jitter_s: float, pauses_s: list[float], seed: int
) -> None:
    delay = Delay(0.5, jitter_s, reorders=False, seed=seed)
    now_s, last_arrival_s = 1000.0, 0.0
    for pause_s in pauses_s:
        now_s += pause_s
        delay_s = delay.at(now_s)
        assert abs(delay_s - 0.5) <= jitter_s + 1e-9
        assert now_s + delay_s >= last_arrival_s - 1e-9
        last_arrival_s = now_s + delay_s
