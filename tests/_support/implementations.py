"""The hot path in C and in Python: tests of what both do run over both."""

import pytest

from robbie_mp.bus._hot import choice
from robbie_mp.bus._hot.choice import Native

NATIVE = choice.native()
"""What is written in C; None if it was not built, or Python was chosen."""

BOTH = [
    pytest.param(None, id="python"),
    pytest.param(NATIVE, id="c", marks=pytest.mark.skipif(NATIVE is None, reason=choice.why_not() or "C")),
]
"""Values of a parameter `native: Native | None`."""

__all__ = ["BOTH", "NATIVE", "Native"]
