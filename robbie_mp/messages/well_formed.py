"""Whether the values of a message make sense together: its types say so beside their fields.

A type with rules defines `flaw`; messages nested in it are checked as well. Rules look at single numbers,
sizes and small arrays, never at the contents of large ones.
"""

import re

from robbie_mp.messages.errors import IllFormed
from robbie_mp.messages.flaws import Flaw
from robbie_mp.messages.message import Message


def find_flaw(message: Message) -> Flaw | None:
    """Return the first flaw of a message or of a message nested in it; None if it is well formed."""
    for name, is_list in message._ruled:
        value = getattr(message, name)
        if not is_list:
            if (flaw := find_flaw(value)) is not None:
                return flaw._replace(field=f"{name}.{flaw.field}")
            continue
        for index, one in enumerate(value):
            if (flaw := find_flaw(one)) is not None:
                return flaw._replace(field=f"{name}[{index}].{flaw.field}")
    return message.flaw()


def check_well_formed(message: Message) -> None:
    """Check a message and all messages nested in it.

    Raises:
        IllFormed: a rule of its type, or of one nested in it, does not hold.
    """
    if message.has_rules and (flaw := find_flaw(message)) is not None:
        raise ill_formed(message.type_name, flaw)


def ill_formed(type_name: str, flaw: Flaw) -> IllFormed:
    """Return the error for a flaw."""
    text = f"{type_name}.{flaw.field} is {flaw.value!r:.60}; expected {flaw.expected}"
    return IllFormed(text, type_name, re.sub(r"\[\d+\]", "[]", flaw.field))
