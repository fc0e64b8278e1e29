"""When a module has to look after its calls and services."""

NEVER_NS = (1 << 63) - 1


class Due:
    """The machine's monotonic time at which something is to be done, in ns; NEVER_NS: nothing is.

    It may be too early, never too late: a call that ends before its time leaves it as it is. The loop of a
    module compares it with the clock in each turn, also in C.
    """

    __slots__ = ("ns",)

    def __init__(self) -> None:
        self.ns = NEVER_NS

    def bring_forward(self, ns: int) -> None:
        """Let something be due at a time, if nothing is due before."""
        self.ns = min(self.ns, ns)
