"""Checks that nodes form a tree."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.scene.errors import DuplicateNode, MissingParent, NodeCycle, SceneGraphError
from robbie_mp.scene.node import Joint, JointType, Mimic, Node


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
    yield from _mimic_problems(nodes, {name: node.joint for name, node in joints.items() if node.joint})


def _mimic_problems(
    nodes: Sequence[Node], joints: dict[str, Joint]
) -> Iterator[tuple[Node, SceneGraphError]]:
    known = {name: joint for name, joint in joints.items() if name}
    leaders: dict[str, Mimic] = {}
    for node in nodes:
        try:
            if node.joint is not None and node.joint.mimic is not None:
                follow(node.joint, known, leaders)
        except SceneGraphError as error:
            yield node, error


def follow(joint: Joint, joints: Mapping[str, Joint], leaders: dict[str, Mimic]) -> Joint:
    """Return a joint that follows the first joint of its chain, which follows none.

    Args:
        joint: follows another joint, which may follow a third.
        joints: all joints by their names.
        leaders: what is known of other joints, for those that follow no joint that follows one; it grows.

    Raises:
        MissingParent: a joint of the chain does not exist.
        NodeCycle: the joints follow one another in a circle.
        BadJoint: the product of the multipliers is not finite.
    """
    chain: dict[str, Joint] = {}
    at = joint
    while at.mimic is not None and at.name not in leaders:
        if at.name in chain:
            circle = [*chain][[*chain].index(at.name) :]
            raise NodeCycle(f"joints follow one another: {' follows '.join(map(repr, [*circle, at.name]))}")
        chain[at.name] = at
        at = _leader(at, at.mimic, joints)
    for each in reversed(chain.values()):
        assert each.mimic is not None
        leaders[each.name] = each.mimic.after(leaders.get(each.mimic.joint))
    return replace(joint, mimic=leaders[joint.name])


def _leader(joint: Joint, mimic: Mimic, joints: Mapping[str, Joint]) -> Joint:
    if mimic.joint not in joints:
        hint = did_you_mean(mimic.joint, joints)
        raise MissingParent(f"joint {joint.name!r} follows {mimic.joint!r}, which does not exist{hint}")
    return joints[mimic.joint]


def parents_first(nodes: Sequence[Node]) -> list[Node]:
    """Return the nodes of a tree with each after its parent."""
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
