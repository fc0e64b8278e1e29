"""Types that the robot does not know until another system sends messages of them."""

from collections.abc import Iterable

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.bridge.mapping import Incoming
from robbie_mp.connect.bridge.surroundings import BridgeRun
from robbie_mp.messages import UnknownType
from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.run.learnt_types import learn_type

MAX_FOREIGN = 64
"""Most types that a bridge learns: code is generated for each of them."""


class ForeignTypeRefused(RobbieError, ValueError):
    """A bridge does not take messages of a type that the robot does not know.

    Example scenarios:
      - `accept` has a pattern for other types
      - the robot knows the type after all, or has learnt another definition of it
    """


class RecordersDoNotLearn(RobbieError, OSError):
    """A type cannot be written down for the run's recorders; its messages can be taken all the same."""


def learn_foreign(
    surroundings: BridgeRun,
    incoming: Incoming,
    described: TypeDescription,
    learnt: Iterable[TypeDescription],
) -> None:
    """Make a type known in the run.

    Args:
        surroundings: the run.
        incoming: what `accept` says about the topic on which its messages come.
        described: the type.
        learnt: the types that this bridge has learnt.

    Raises:
        ForeignTypeRefused: its messages are not taken; the text says why.
        RecordersDoNotLearn: they are, but recorders do not learn the type.
    """
    if not incoming.matches(described.name):
        raise ForeignTypeRefused(f"`accept` takes only {incoming.type_name}")
    try:
        known = surroundings.types.describe(described.name)
    except UnknownType:
        known = described
    if known.python_module:
        raise ForeignTypeRefused("the robot knows this type: write its name instead of a pattern in `accept`")
    is_known = all(one == described for one in learnt if one.name == described.name)
    try:
        if is_known and surroundings.folder is not None:
            is_known = learn_type(surroundings.folder, described)
    except OSError as error:
        raise RecordersDoNotLearn(f"recorders do not learn it: {error}") from error
    if not is_known:
        raise ForeignTypeRefused("in this run it has had another definition; start the robot again")
