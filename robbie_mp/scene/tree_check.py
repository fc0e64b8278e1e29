"""Checks that nodes form a tree."""

from collections.abc import Iterator, Sequence

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.scene.errors import BadJoint, DuplicateNode, MissingParent, NodeCycle, SceneGraphError
from robbie_mp.scene.node import JointType, Node


def tree_problems(nodes: Sequence[Node]) -> Iterator[tuple[Node, SceneGraphError]]:
    """Yield every reason why the nodes are not one or several trees, each with the node concerned."""
    by_name: dict[str, Node] = {}
    for node in nodes:
        if node.name in by_name:
            yield node, DuplicateNode(f"node {node.name!r} is described twice")
        by_name.setdefault(node.name, node)
    for node in nodes:
        if node.parent is not None and node.parent not in by_name:
            hint = did_you_mean(node.parent, by_name)
            yield (
                node,
                MissingParent(f"the parent of node {node.name!r}, {node.parent!r}, does not exist{hint}"),
            )
    yield from _cycles(by_name)
    yield from _joint_problems(nodes)


def _cycles(by_name: dict[str, Node]) -> Iterator[tuple[Node, SceneGraphError]]:
    done: set[str] = set()
    for start in by_name:
        way: dict[str, None] = {}
        at: str | None = start
        while at is not None and at in by_name and at not in done:
            if at in way:
                circle = [*way][[*way].index(at) :]
                yield by_name[at], NodeCycle(f"nodes hang on one another: {' on '.join([*circle, at])}")
                break
            way[at] = None
            at = by_name[at].parent
        done.update(way)


def _joint_problems(nodes: Sequence[Node]) -> Iterator[tuple[Node, SceneGraphError]]:
    joints: dict[str, Node] = {}
    for node in nodes:
        name = node.joint.name if node.joint else ""
        if name and name in joints:
            yield (
                node,
                DuplicateNode(f"joint {name!r} is described twice, also at node {joints[name].name!r}"),
            )
        joints.setdefault(name, node)
    for node in nodes:
        mimic = node.joint.mimic if node.joint else None
        if node.joint is None or mimic is None:
            continue
        leader = joints[mimic.joint].joint if mimic.joint in joints and mimic.joint else None
        if leader is None:
            hint = did_you_mean(mimic.joint, filter(None, joints))
            yield (
                node,
                MissingParent(
                    f"joint {node.joint.name!r} follows {mimic.joint!r}, which does not exist{hint}"
                ),
            )
        elif leader.mimic is not None:
            yield node, BadJoint(f"joint {node.joint.name!r} follows {mimic.joint!r}, which follows another")


def parents_first(nodes: Sequence[Node]) -> list[Node]:
    """Return the nodes of a tree with each after its parent, and followers after the joints they follow."""
    children: dict[str | None, list[Node]] = {}
    for node in nodes:
        children.setdefault(node.parent, []).append(node)
    ordered = list(children.get(None, []))
    for node in ordered:  # grows during the loop
        ordered.extend(children.get(node.name, []))
    return ordered


def is_joint(node: Node) -> bool:
    """Return whether a node has a joint that does not follow another one."""
    joint = node.joint
    return joint is not None and joint.type is not JointType.FLOATING and joint.mimic is None
