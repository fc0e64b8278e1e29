"""What became of everything that a reader has read: it was used, or left out for a reason."""

from robbie_mp.base.errors import RobbieError

MAX_REASONS = 50
"""Different reasons of one balance; reasons name topics and types of foreign files, so they need a bound."""
OTHER_REASONS = "other reasons"


class LeftOut(RobbieError, ValueError):
    """Something would be left out, and the caller allowed no loss.

    Example scenarios:
      - `robbie import-rosbag --strict` of a bag in which one topic has a type without a definition
    """


class Balance:
    """Counts what a reader has used and left out, in units of its own: messages, lines, cells.

    Args:
        is_strict: raise `LeftOut` at the first loss.

    Attributes:
        used: how many were used.
        left_out: how many were not, by reason.
    """

    def __init__(self, *, is_strict: bool = False):
        self.used = 0
        self.left_out: dict[str, int] = {}
        self._is_strict = is_strict

    @property
    def read(self) -> int:
        """How many were read: used and left out."""
        return self.used + sum(self.left_out.values())

    def use(self, count: int = 1) -> None:
        """Count what was used."""
        self.used += count

    def leave_out(self, reason: str, count: int = 1) -> None:
        """Count what was left out.

        Raises:
            LeftOut: no loss is allowed.
        """
        if count and self._is_strict:
            raise LeftOut(f"{count} left out: {reason}; without --strict, the rest is used")
        if reason not in self.left_out and len(self.left_out) >= MAX_REASONS:
            reason = OTHER_REASONS
        if count:
            self.left_out[reason] = self.left_out.get(reason, 0) + count

    def lines(self, unit: str) -> list[str]:
        """Return the balance as lines of text.

        Args:
            unit: what is counted, in the plural: `messages`.
        """
        lost = sum(self.left_out.values())
        total = f"read {self.read} {unit}: {self.used} used, {lost} left out"
        return [total, *(f"left out {count}: {reason}" for reason, count in self.left_out.items())]
