"""Names in /dev/shm, by which the processes of a run find each other's memory.

The segments of a run lie in the folder `robbie-RUN/`, which is closed to other users. They cannot see, take
or forge names in it, so those names are predictable.
"""


def folder(run_id: str) -> str:
    """The folder of a run's segments."""
    return f"robbie-{run_id}"


def home(run_id: str) -> str:
    """A link to the folder of the run, which `XDG_RUNTIME_DIR` hides from other sessions of its user."""
    return f"{folder(run_id)}/home"


def board(run_id: str) -> str:
    """The supervisor's board."""
    return f"{folder(run_id)}/board"


def clock(run_id: str) -> str:
    """The run's clock, in a run that has its own time."""
    return f"{folder(run_id)}/clock"


def core(run_id: str) -> str:
    """The core's tables."""
    return f"{folder(run_id)}/core"


def outbound(run_id: str, slot: int, incarnation: int) -> str:
    """The segment that one incarnation of a module writes."""
    return f"{folder(run_id)}/out-{slot}-{incarnation}"


def inbound(run_id: str, slot: int, incarnation: int) -> str:
    """The segment that the core writes for it."""
    return f"{folder(run_id)}/in-{slot}-{incarnation}"


def data(run_id: str, slot: int, incarnation: int, segment: int) -> str:
    """One of its data segments."""
    return f"{data_prefix(run_id, slot, incarnation)}{segment}"


def checkpoint(run_id: str, slot: int, number: int) -> str:
    """One of the two segments for a module's checkpoints; they outlive its incarnations."""
    return f"{folder(run_id)}/checkpoint-{slot}-{number}"


def history(run_id: str, slot: int, incarnation: int) -> str:
    """What one incarnation of a module has handled."""
    return f"{folder(run_id)}/history-{slot}-{incarnation}"


def data_prefix(run_id: str, slot: int, incarnation: int) -> str:
    """Common prefix of the names of all its data segments."""
    return f"{folder(run_id)}/data-{slot}-{incarnation}-"


def wakeup(run_id: str, slot: int, incarnation: int) -> str:
    """The word that wakes it."""
    return f"{folder(run_id)}/wakeup-{slot}-{incarnation}"


def core_wakeup(run_id: str) -> str:
    """The word that wakes the core."""
    return f"{folder(run_id)}/wakeup-core"
