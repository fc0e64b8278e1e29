"""dora-rs: a daemon passes arrow arrays between the nodes, large ones through shared memory."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from tools.bench.peers.peer import Peer, Send
from tools.bench.publishing import passing_on
from tools.bench.record import OnMessage
from tools.bench.work import Work

QUEUE = 100
SHARED_MESSAGES = 8
"""Number of large messages that a publisher's memory holds. Dora's default cannot hold two of 6 MB."""


class Dora(Peer):
    """A dataflow of a publisher and its subscribers, run by `dora.run`."""

    title = "dora-rs"
    package = "dora-rs"
    module = "dora"
    how = "arrow arrays, stamp in the metadata; Node.next blocks"

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        """Return the command with which dora starts all nodes."""
        dataflow = work.folder / "dataflow.yml"
        pool = SHARED_MESSAGES * max(work.size_bytes, 1 << 20)
        outputs = f"    outputs: [message]\n    env: {{DORA_NODE_SHM_POOL_SIZE: {pool}}}\n"
        policy = "\n        queue_policy: backpressure" if work.lossless else ""

        def inputs(source: str) -> str:
            queue = f"        queue_size: {QUEUE}{policy}\n"
            return f"    inputs:\n      message:\n        source: {source}/message\n{queue}"

        sources = ["publisher", *(f"stage-{index}" for index in range(work.stages))]
        nodes = [_node("publisher", name, work_file, outputs)]
        for source, stage in pairwise(sources):
            nodes.append(_node(stage, name, work_file, inputs(source) + outputs))
        for index in range(work.subscribers):
            nodes.append(_node(f"subscriber-{index}", name, work_file, inputs(sources[-1])))
        dataflow.write_text("nodes:\n" + "".join(nodes))
        return [[sys.executable, "-c", f"import dora; dora.run({str(dataflow)!r})"]]

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Send outputs."""
        import dora  # noqa: PLC0415

        yield self._sender(work, dora.Node())

    def _sender(self, work: Work, node: Any) -> Send:
        import numpy as np  # noqa: PLC0415
        import pyarrow as pa  # noqa: PLC0415

        data = pa.array(np.ones(work.size_bytes, np.uint8)) if work.has_array else None

        def send(number: int) -> None:
            values = pa.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
            node.send_output("message", values, {"number": number, "stamp_ns": time.monotonic_ns()})

        def send_array(number: int) -> None:
            node.send_output("message", data, {"number": number, "stamp_ns": time.monotonic_ns()})

        return send_array if work.has_array else send

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Receive inputs."""
        import dora  # noqa: PLC0415

        self._receive(dora.Node(), handle)

    def pass_on(self, source: Work, target: Work) -> None:
        """Receive and send with the same node: a process has one."""
        import dora  # noqa: PLC0415

        node = dora.Node()
        self._receive(node, passing_on(source, self._sender(target, node)))

    def _receive(self, node: Any, handle: OnMessage) -> None:
        for event in node:
            if event["type"] == "INPUT":
                metadata: Any = event["metadata"]
                if handle(metadata["number"], metadata["stamp_ns"]):
                    return


def _node(role: str, name: str, work_file: Path, rest: str) -> str:
    arguments = f"-m tools.bench.worker {name} {role} {work_file}"
    return f"  - id: {role}\n    path: {sys.executable}\n    args: {arguments}\n{rest}"


PEER = Dora()
