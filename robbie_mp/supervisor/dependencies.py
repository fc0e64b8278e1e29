"""Which children are restarted together with which."""

from collections.abc import Sequence

from robbie_mp.supervisor.states import ChildState
from robbie_mp.supervisor.supervised_child import SupervisedChild


class Dependencies:
    """Answers by what the specs of all children say; between a restart of two there is no other tie.

    As with Erlang's `rest_for_one`, but for the declared dependents only, and without waiting for their end.
    """

    def __init__(self, children: Sequence[SupervisedChild]):
        """Take all children, in the order of their start."""
        self._children = children

    def dependents(self, child: SupervisedChild) -> list[SupervisedChild]:
        """Return who depends on a child, directly or through others, in the order of their start."""
        reached = {child.spec.name}
        grown = True
        while grown:
            more = {c.spec.name for c in self._children if not reached.isdisjoint(c.spec.depends_on)}
            grown = not more <= reached
            reached |= more
        return [c for c in self._children if c.spec.name in reached and c is not child]

    def are_settled(self, child: SupervisedChild) -> bool:
        """Whether everyone that a child depends on is RUNNING, or will not run without help."""
        return all(
            (other.state is ChildState.RUNNING and not other.is_stopping)
            or (other.state is not None and other.state.is_final)
            for other in self._children
            if other.spec.name in child.spec.depends_on
        )
