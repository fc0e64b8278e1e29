"""One process of a peer: `python -m tools.bench.worker PEER ROLE WORK.json`."""

import importlib
import os
import sys
from pathlib import Path

from tools.bench.peers.peer import Peer
from tools.bench.publishing import publish_all
from tools.bench.record import Receipts
from tools.bench.work import Work

PUBLISHER = "publisher"
RELAY = "relay"
STAGE = "stage-"
SUBSCRIBER = "subscriber-"


def load_peer(name: str) -> Peer:
    """Return the peer that a file of this name describes."""
    peer: Peer = importlib.import_module(f"tools.bench.peers.{name}").PEER
    return peer


def run(peer: Peer, role: str, work: Work) -> None:
    """Play one role until the work is done."""
    if work.cpus:
        os.sched_setaffinity(0, work.cpus)
    if work.realtime_priority:  # threads that are started later inherit it
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(work.realtime_priority))
    if role == PUBLISHER:
        with peer.publisher(work.hop(0)) as send:
            publish_all(work, send)
    elif role == RELAY:
        peer.relay(work)
    elif role.startswith(STAGE):
        index = int(role.removeprefix(STAGE))
        peer.pass_on(work.hop(index), work.hop(index + 1))
    else:
        index = int(role.removeprefix(SUBSCRIBER))
        peer.receive(work.hop(work.stages), index, Receipts(work, index).handle)


if __name__ == "__main__":
    run(load_peer(sys.argv[1]), sys.argv[2], Work.load(Path(sys.argv[3])))
