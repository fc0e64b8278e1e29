"""Tracebacks without the frames of Robbie-MP, which tell the author of a module nothing."""

from pathlib import Path
from types import TracebackType

import robbie_mp
from robbie_mp.base.errors import RobbieError

OURS = (f"{Path(robbie_mp.__file__).parent}/", "<frozen importlib")


def leave_out_our_frames(error: BaseException) -> None:
    """Take our frames from the traceback of an exception and of its causes.

    Those that called the module's code go, and of an error that we raise on purpose also those behind it,
    with a cause that is ours alone. If nothing would be left, all stay.
    """
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        if kept := _kept(one):
            one.__traceback__ = _linked(kept)
        cause = one.__cause__ or one.__context__
        if kept and isinstance(one, RobbieError) and cause is not None and not _kept(cause):
            one.__cause__, cause = None, None  # which also suppresses the context
        one = cause


def _kept(error: BaseException) -> list[TracebackType]:
    frames = []
    at = error.__traceback__
    while at is not None:
        frames.append(at)
        at = at.tb_next
    theirs = [number for number, frame in enumerate(frames) if not _is_ours(frame)]
    if not theirs:
        return []
    return frames[theirs[0] : theirs[-1] + 1 if isinstance(error, RobbieError) else None]


def _is_ours(frame: TracebackType) -> bool:
    return frame.tb_frame.f_code.co_filename.startswith(OURS)


def _linked(frames: list[TracebackType]) -> TracebackType:
    for frame, following in zip(frames, [*frames[1:], None], strict=True):
        frame.tb_next = following
    return frames[0]
