"""Tracebacks without the frames of Robbie-MP, which tell the author of a module nothing."""

import re
import sysconfig
from pathlib import Path
from types import TracebackType

import robbie_mp
from robbie_mp.base.errors import RobbieError

STANDARD_LIBRARY = sysconfig.get_paths()["stdlib"]
OURS = (
    f"{Path(robbie_mp.__file__).parent}/",
    "robbie_mp/bus/_hot/",  # Cython names its sources as they were named when it compiled them
    "<frozen importlib",
    f"{STANDARD_LIBRARY}/importlib/",
)
LIBRARIES = re.compile(rf".*/(site|dist)-packages/|{re.escape(STANDARD_LIBRARY)}/")
SAYS_ALL = (RobbieError, OSError)
"""Errors whose text says what is wrong, so that only the line of the module that meets them counts."""

_OF_A_DUMP = re.compile(
    rf'  File "(?:{re.escape(OURS[0])}|<)[^"]*", line \d+ in '
    r"|Extension modules: |Fatal Python error: Aborted$"
)
"""Lines of a dump by faulthandler that tell the author of a module nothing."""


def tells_nothing(line: str) -> bool:
    """Whether a line that a hung module has printed is about our frames, or none at all."""
    return _OF_A_DUMP.match(line) is not None


def leave_out_our_frames(error: BaseException) -> None:
    """Take our frames from the traceback of an exception and of its causes.

    Those that called the module's code go, and of an error that we raise on purpose also those behind it,
    with a cause that is ours alone. So do those of libraries behind an error of the system, such as a port
    that is not there: its text says it all. If nothing would be left, all stay, but for an error that we
    raise on purpose: none of its frames is of use to the module's author.
    """
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        if kept := _kept(one):
            one.__traceback__ = _linked(kept)
        elif isinstance(one, RobbieError):
            one.__traceback__ = None
        cause = one.__cause__ or one.__context__
        if kept and isinstance(one, SAYS_ALL) and cause is not None and not _kept(cause):
            one.__cause__, cause = None, None  # which also suppresses the context
        one = cause


def _kept(error: BaseException) -> list[TracebackType]:
    frames = []
    at = error.__traceback__
    while at is not None:
        frames.append(at)
        at = at.tb_next
    theirs = [number for number, frame in enumerate(frames) if not _is_of_others(frame, error)]
    if not theirs:
        return []
    return frames[theirs[0] : theirs[-1] + 1 if isinstance(error, SAYS_ALL) else None]


def _is_of_others(frame: TracebackType, error: BaseException) -> bool:
    """Whether a frame is none of the module's author: ours, or of a library where the system refused."""
    file = frame.tb_frame.f_code.co_filename
    return file.startswith(OURS) or (isinstance(error, OSError) and LIBRARIES.match(file) is not None)


def _linked(frames: list[TracebackType]) -> TracebackType:
    for frame, following in zip(frames, [*frames[1:], None], strict=True):
        frame.tb_next = following
    return frames[0]
