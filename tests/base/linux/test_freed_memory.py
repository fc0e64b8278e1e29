"""A process uses memory again that it has freed, and the kernel need not clear it again."""

import subprocess
import sys

FAULTS = """
import resource, sys
from robbie_mp.base.linux.freed_memory import keep_freed_memory
if sys.argv[1] == "kept":
    assert keep_freed_memory(16 << 20)
source = memoryview(bytearray(1 << 20))
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    kept = [bytes(source) for _ in range(8)]
    del kept
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults(), faults()
print(faults())
"""


def faults(how: str) -> int:
    """Page faults of a process that fills 8 MB a third time."""
    done = subprocess.run([sys.executable, "-c", FAULTS, how], check=True, capture_output=True, text=True)
    return int(done.stdout)


def test_freed_memory_is_used_again_without_page_faults() -> None:
    assert faults("usual") > 1000
    assert faults("kept") < 100
