"""Names in shared memory: all begin with `robbie-RUN-`, so that a run's leftovers can be told."""


def run_prefix(run_id: str) -> str:
    """What every name of a run begins with."""
    return f"robbie-{run_id}-"


def board(run_id: str) -> str:
    """The supervisor's board."""
    return f"robbie-{run_id}-board"


def clock(run_id: str) -> str:
    """The run's time, where it is not the machine's."""
    return f"robbie-{run_id}-clock"


def core(run_id: str) -> str:
    """The core's tables."""
    return f"robbie-{run_id}-core"


def core_wakeup(run_id: str) -> str:
    """The semaphore that wakes the core."""
    return f"robbie-{run_id}-core-wakeup"


def outbound(run_id: str, slot: int, incarnation: int) -> str:
    """The segment that one incarnation of a module writes."""
    return f"robbie-{run_id}-out-{slot}-{incarnation}"


def inbound(run_id: str, slot: int, incarnation: int) -> str:
    """The segment that the core writes for it."""
    return f"robbie-{run_id}-in-{slot}-{incarnation}"


def wakeup(run_id: str, slot: int, incarnation: int) -> str:
    """The semaphore that wakes it."""
    return f"robbie-{run_id}-wakeup-{slot}-{incarnation}"


def data(run_id: str, slot: int, incarnation: int, segment: int) -> str:
    """One of its data segments."""
    return f"{data_prefix(run_id, slot, incarnation)}{segment}"


def checkpoint(run_id: str, slot: int, number: int) -> str:
    """One of the two segments for a module's checkpoints; they outlive its incarnations."""
    return f"robbie-{run_id}-checkpoint-{slot}-{number}"


def data_prefix(run_id: str, slot: int, incarnation: int) -> str:
    """What the names of all its data segments begin with."""
    return f"robbie-{run_id}-data-{slot}-{incarnation}-"
