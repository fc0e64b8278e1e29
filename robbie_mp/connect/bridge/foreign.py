"""Types that the robot does not know until another system sends messages of them."""

import os
import re
from collections.abc import Iterable
from pathlib import Path

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
      - the robot's code declares a type of that name
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
    if (file := declaring_file(surroundings.code, described.name)) is not None:
        raise ForeignTypeRefused(
            f"{file} declares a type of that name, which is the robot's own: declare it where a module is "
            "imported, and write its name instead of a pattern in `accept`"
        )
    is_known = all(one == described for one in learnt if one.name == described.name)
    try:
        if is_known and surroundings.folder is not None:
            is_known = learn_type(surroundings.folder, described)
    except OSError as error:
        raise RecordersDoNotLearn(f"recorders do not learn it: {error}") from error
    if not is_known:
        raise ForeignTypeRefused("in this run it has had another definition; start the robot again")


def declaring_file(folders: Iterable[Path], type_name: str) -> Path | None:
    """Return a Python file that declares a type, by its full name; None: there is none.

    A module may import the class only when it uses it. If another system had described the type before, with
    other fields, the module could not use its class. A name that is put together at run time is not found.

    Args:
        folders: where the files are, in any depth.
        type_name: the full name.
    """
    kinds = rb"\bname\s*=|\bmessage_type_from_schema\("
    declaration = re.compile(rb"(?:%s)\s*([\"'])%s\1" % (kinds, re.escape(type_name.encode())))
    for folder in folders:
        for place, inner, files in os.walk(folder):
            is_environment = "pyvenv.cfg" in files
            inner[:] = [] if is_environment else [one for one in inner if not one.startswith((".", "__"))]
            for file in (Path(place, one) for one in files if one.endswith(".py") and not is_environment):
                try:
                    if declaration.search(file.read_bytes()):
                        return file
                except OSError:
                    continue
    return None
