"""Random poses and trees."""

import math

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from robbie_mp.scene import Joint, JointType, Node, RigidTransform

# A busy machine takes its time, and no test keeps anything in a fixture from one example to the next.
PATIENT = settings(deadline=None, suppress_health_check=list(HealthCheck))
LENGTHS = st.floats(-10.0, 10.0)
ANGLES = st.floats(-math.pi, math.pi)
DIRECTIONS = st.tuples(LENGTHS, LENGTHS, LENGTHS).filter(lambda axis: math.hypot(*axis) > 0.1)


@st.composite
def poses(draw: st.DrawFn) -> RigidTransform:
    parts = draw(st.tuples(LENGTHS, LENGTHS, LENGTHS, LENGTHS).filter(lambda each: math.hypot(*each) > 0.1))
    length = math.hypot(*parts)
    return RigidTransform.of(
        draw(st.tuples(LENGTHS, LENGTHS, LENGTHS)), tuple(part / length for part in parts)
    )


@st.composite
def trees(draw: st.DrawFn) -> list[Node]:
    """One tree of up to 12 nodes; the parent of each is one of the earlier nodes."""
    nodes = [Node("n0")]
    for number in range(1, draw(st.integers(2, 12))):
        parent = f"n{draw(st.integers(0, number - 1))}"
        kind = draw(st.sampled_from(list(JointType)))
        name = f"n{number}"
        if kind is JointType.FIXED:
            nodes.append(Node(name, parent, draw(poses())))
        elif kind is JointType.FLOATING:
            nodes.append(Node(name, parent, joint=Joint(kind)))
        else:
            nodes.append(Node(name, parent, draw(poses()), Joint(kind, f"j{number}", draw(DIRECTIONS))))
    return nodes
