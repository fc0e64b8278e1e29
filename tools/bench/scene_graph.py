"""Measures the cost of a scene graph: four robots of 50 nodes in one world, 500 updates a second.

    python -m tools.bench.scene_graph [--seconds 10] [--json]

The stamps advance as in a robot, but the tool does not wait. After each update, it looks up 4 poses between
random nodes, at times within the last second. A second world is the worst case: 200 nodes in one chain, each
on a separate joint. Then the tool sends the same number of joint states to the service, and a listener takes
everything that the service publishes.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from robbie_mp import Header, Module, ModuleHarness, Time
from robbie_mp.messages import JointState
from robbie_mp.scene import Joint, JointType, Node, RigidTransform, SceneGraph, SceneGraphListener
from robbie_mp.scene.module import SceneGraphService

UPDATES_PER_S = 500
LOOK_UPS_PER_UPDATE = 4
PLACE = RigidTransform.from_rpy((0.1, 0.02, 0.2), (0.1, -0.2, 0.3))
FLOATING = Joint(JointType.FLOATING)


def robot(prefix: str) -> list[Node]:
    """Return 50 nodes: a base with four wheels, an arm of seven joints with a hand, and fixed sensors."""
    nodes = [
        Node(f"{prefix}map", "world", PLACE),
        Node(f"{prefix}odom", f"{prefix}map", joint=FLOATING),
        Node(f"{prefix}base", f"{prefix}odom", joint=FLOATING),
    ]
    for number in range(4):
        wheel = f"{prefix}wheel{number}"
        nodes.append(Node(wheel, f"{prefix}base", PLACE, Joint(JointType.CONTINUOUS, wheel)))
    link = f"{prefix}base"
    for number in range(7):
        parent, link = link, f"{prefix}arm{number}"
        nodes.append(Node(link, parent, PLACE, Joint(JointType.REVOLUTE, link)))
    for number in range(2):
        finger = f"{prefix}finger{number}"
        nodes.append(Node(finger, link, PLACE, Joint(JointType.PRISMATIC, finger)))
    for number in range(34):
        parent = f"{prefix}base" if number % 2 else link
        nodes.append(Node(f"{prefix}sensor{number}", parent, PLACE))
    return nodes


def world_of_robots() -> list[Node]:
    """Return a world of four robots, 201 nodes."""
    return [Node("world"), *(node for number in range(4) for node in robot(f"robot{number}/"))]


def row() -> list[Node]:
    """Return 200 nodes in a chain, each connected to the previous one by a joint."""
    nodes = [Node("n0")]
    for number in range(1, 200):
        joint = Joint(JointType.REVOLUTE, f"j{number}")
        nodes.append(Node(f"n{number}", f"n{number - 1}", PLACE, joint))
    return nodes


def mover(graph: SceneGraph, node: Node, random: Random) -> Callable[[int], None]:
    """Return a function that updates a node at a time (ns)."""
    joint = node.joint
    assert joint is not None
    if joint.name:
        return lambda time_ns: graph.set_joint(joint.name, time_ns, random.uniform(-1.0, 1.0))
    return lambda time_ns: graph.move(
        node.name, time_ns, RigidTransform.from_rpy((random.random(), 0.0, 0.0), (0.0, 0.0, random.random()))
    )


def measure(nodes: list[Node], seconds: float) -> dict[str, float]:
    """Return the processor time (µs) of an update and of a look-up."""
    random, graph = Random(1), SceneGraph(nodes)
    names = [node.name for node in nodes]
    movers = [mover(graph, node, random) for node in nodes if node.joint is not None]
    updates, look_ups = [], []
    for move in movers:
        move(0)
    for step in range(1, round(seconds * UPDATES_PER_S) + 1):
        now_ns = step * 1_000_000_000 // UPDATES_PER_S
        began_ns = time.thread_time_ns()
        movers[step % len(movers)](now_ns)
        updates.append(time.thread_time_ns() - began_ns)
        # Long enough ago that every node has been updated since.
        known_ns = now_ns - len(movers) * 1_000_000_000 // UPDATES_PER_S
        for _ in range(LOOK_UPS_PER_UPDATE):
            a, b = random.choice(names), random.choice(names)
            at_ns = random.randint(max(0, known_ns - 1_000_000_000), max(0, known_ns))
            began_ns = time.thread_time_ns()
            graph.pose(a, b, at_ns)
            look_ups.append(time.thread_time_ns() - began_ns)
    result: dict[str, float] = {"nodes": len(nodes), "joints": len(movers), "updates_per_s": UPDATES_PER_S}
    for name, times in (("update", updates), ("look_up", look_ups)):
        p50, p99 = np.percentile(times, (50, 99)) / 1e3
        result |= {
            f"{name}_mean_us": float(np.mean(times)) / 1e3,
            f"{name}_p50_us": p50,
            f"{name}_p99_us": p99,
        }
    return {key: round(value, 1) for key, value in result.items()}


class Listening(Module):
    """A module that listens to the scene graph."""

    def setup(self) -> None:
        """Listen."""
        self.scene = SceneGraphListener(self)


def measure_service(nodes: list[Node], seconds: float) -> dict[str, float]:
    """Return the processor time (%) of service and listener, including the coding of their messages."""
    random, joints = Random(1), [node.joint.name for node in nodes if node.joint and node.joint.name]
    spent_ns = {"service": 0, "listener": 0}
    with TemporaryDirectory() as folder:
        file = Path(folder) / "world.yaml"
        file.write_text(scene_text(nodes))
        with (
            ModuleHarness(SceneGraphService, {"file": str(file)}) as service,
            ModuleHarness(Listening) as other,
        ):
            for step in range(1, round(seconds * UPDATES_PER_S) + 1):
                header = Header(stamp=Time.from_nanoseconds(step * 1_000_000_000 // UPDATES_PER_S))
                name = joints[step % len(joints)]
                angle_rad = random.uniform(-1.0, 1.0)
                state = JointState(header=header, name=[name], position=np.array([angle_rad]))
                began_ns = time.thread_time_ns()
                service.send(state)
                service.advance(1.0 / UPDATES_PER_S)
                between_ns = time.thread_time_ns()
                for message, topic in service.published:
                    other.send(message, topic=topic)
                service.published.clear()
                spent_ns["service"] += between_ns - began_ns
                spent_ns["listener"] += time.thread_time_ns() - between_ns
    return {f"{name}_cpu_percent": round(spent / seconds / 1e7, 1) for name, spent in spent_ns.items()}


def scene_text(nodes: list[Node]) -> str:
    """Return a scene file of nodes."""
    described: dict[str, dict[str, object]] = {}
    for node in nodes:
        fields: dict[str, object] = {}
        if node.parent is not None:
            fields["parent"] = node.parent
        if node.joint is not None:
            name = {"name": node.joint.name} if node.joint.name else {}
            fields["joint"] = {"type": node.joint.type.value, **name}
        if node.origin != RigidTransform():
            fields |= {"translation": list(node.origin[:3]), "quaternion": list(node.origin[3:])}
        described[node.name] = fields
    return yaml.safe_dump({"nodes": described}, sort_keys=False)


def main(arguments: list[str]) -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.scene_graph", description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="robot time to measure")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    worlds = {"four robots": world_of_robots(), "one row": row()}
    results = {name: measure(nodes, options.seconds) for name, nodes in worlds.items()}
    results["four robots"] |= measure_service(worlds["four robots"], options.seconds)
    if options.json:
        print(json.dumps(results, indent=2))
        return 0
    for name, figures in results.items():
        print(f"{name}: {figures['nodes']:.0f} nodes, {figures['joints']:.0f} joints")
        for what in ("update", "look_up"):
            mean, p50, p99 = (figures[f"{what}_{part}_us"] for part in ("mean", "p50", "p99"))
            print(f"  {what.replace('_', '-'):8} mean {mean:6.1f} µs   p50 {p50:6.1f} µs   p99 {p99:6.1f} µs")
    for name in ("service", "listener"):
        print(f"{name} of four robots: {results['four robots'][f'{name}_cpu_percent']} % of a processor")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
