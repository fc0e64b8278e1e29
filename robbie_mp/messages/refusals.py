"""Refuses messages that are not well formed, counts them by type and reason, and says so without a flood."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING

from robbie_mp.base.errors import RobbieError
from robbie_mp.messages.errors import IllFormed, MessageError
from robbie_mp.messages.message import Message
from robbie_mp.messages.well_formed import check_well_formed

if TYPE_CHECKING:
    from logging import Logger

MAX_KINDS = 64
"""Most types and reasons that are told apart."""
OTHERS = ("other types", "")
SHOWN = 3


class Refusals:
    """Decides which messages come in at one place: a link, a bridge, or the subscriptions of a module.

    Args:
        log: gets a warning at the 1st, 2nd, 4th, 8th, … refusal of a kind.

    Attributes:
        total: number of messages refused.
        by_kind: the same by type and field.
        on_refused: called with the total after each refusal.
    """

    def __init__(self, log: Logger):
        self._log = log
        self.on_refused: Callable[[int], None] = lambda _total: None
        self.total = 0
        self.by_kind: Counter[tuple[str, str]] = Counter()

    def admits(self, message: Message, origin: str = "") -> bool:
        """Return whether a message is well formed; if not, count it.

        Args:
            message: the message.
            origin: whose it is, or where it was to go, for the log.
        """
        return not message.has_rules or self._passes(check_well_formed, message, origin)

    def admits_encoded(self, known: type[Message] | None, data: bytes | memoryview, origin: str = "") -> bool:
        """Return whether an encoded message of a class is well formed; if not, count it.

        Args:
            known: what `class_with_rules` returned; None: any message is well formed.
            data: the message.
            origin: as for `admits`.
        """
        return known is None or self._passes(lambda one: check_well_formed(known.decode(one)), data, origin)

    def count(self, error: RobbieError, origin: str = "") -> None:
        """Count a message that was refused."""
        kind = (error.type_name, error.field) if isinstance(error, IllFormed) else ("", str(error)[:60])
        if kind not in self.by_kind and len(self.by_kind) >= MAX_KINDS:
            kind = OTHERS
        self.total += 1
        self.by_kind[kind] += 1
        count = self.by_kind[kind]
        if count & (count - 1) == 0:
            where = f" ({origin})" if origin else ""
            text = str(error)  # the error itself would hold frames and views
            self._log.warning("refused an ill-formed message%s, %d of this kind: %s", where, count, text)
        self.on_refused(self.total)

    @property
    def summary(self) -> str:
        """The total with the most frequent kinds, in one line; "" if nothing was refused."""
        if not self.total:
            return ""
        kinds = (
            f"{type_name.rpartition('/')[2]} {field}".strip() + f" {count}"
            for (type_name, field), count in self.by_kind.most_common(SHOWN)
        )
        return f"{self.total} ill-formed refused ({', '.join(kinds)})"

    def _passes(self, check: Callable[..., None], message: object, origin: str) -> bool:
        try:
            check(message)
        except MessageError as error:
            self.count(error, origin)
            return False
        return True
