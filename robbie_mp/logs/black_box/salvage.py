"""Makes a clip of what the black box of a dead run has left, before its shared memory is removed."""

import contextlib
import time
from pathlib import Path

from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.logs.black_box.clip_folder import AboutClip, ClipFolder, clip_name
from robbie_mp.logs.black_box.ring import RING, STATE, last_message_s, ring_home, ring_parts
from robbie_mp.logs.black_box.spool import SPOOL, locked, remove_spool
from robbie_mp.logs.black_box.state import BoxState, OpenClip
from robbie_mp.logs.recording.format import part_path
from robbie_mp.run.profile.model import CLIPS_BYTES
from robbie_mp.run.run_directory import read_record

DIED = "the supervisor was killed"


def salvage(
    run_id: str, folder: Path | None, shared_memory: Path = SHARED_MEMORY, *, has_died: bool = True
) -> list[str]:
    """Write the clips that a run still owes, and one about its death; return what to tell the user.

    Args:
        run_id: the run, whose modules are all dead.
        folder: its folder; None if there is none any more.
        shared_memory: where named segments appear.
        has_died: whether its supervisor was killed; otherwise only its black box was, at the end of the run.
    """
    home = ring_home(run_id, shared_memory)
    parts = ring_parts(home / RING)
    record = None if folder is None else read_record(folder)
    if not has_died and record is not None:
        _remove_spool(Path(record.output_directory))
    if not parts:
        if record is not None:
            _remove_spool(Path(record.output_directory))
        return []
    if record is None or not Path(record.output_directory).is_dir():
        return [f"the last messages of run {run_id} are lost: it has no folder for results any more"]
    state, problem = BoxState.load(home / STATE)
    clips = ClipFolder(Path(record.output_directory), CLIPS_BYTES)
    taken = [*clips.names(), *(clip.name for clip in state.open)]
    end_s = last_message_s(home / RING) or time.time()
    end = OpenClip(clip_name(DIED, taken, end_s), 0, 0, parts[0], triggers=[DIED], times_s=[end_s])
    told = [f"run {run_id}: {problem}"] if problem else []
    for clip in [*state.open, *([end] if has_died else [])]:
        try:
            last = parts[-1] if clip.last < 0 else clip.last
            for number in (one for one in parts if clip.first <= one <= last):
                clips.add_part(clip.name, part_path(home / RING, number), number)
            is_whole = clip is end or 0 <= clip.last <= parts[-1]
            cut = "" if is_whole else "the run ended before it was whole"
            about = AboutClip(run_id, record.profile, clip.triggers, clip.times_s, clip.more, cut)
            clips.finish(clip.name, about)
            told.append(f"run {run_id} has left a clip when it was killed: {clips.path / clip.name}")
            if clip is end:
                _remove_spool(Path(record.output_directory))
        except (OSError, LookupError) as error:
            told.append(f"run {run_id}: clip {clip.name} ({', '.join(clip.triggers)}) is lost: {error}")
    return [one_line(line) for line in told]


def _remove_spool(output_directory: Path) -> None:
    """Remove what was for a power cut: the ring has more."""
    with contextlib.suppress(OSError), locked(output_directory / SPOOL) as is_free:
        if is_free:
            remove_spool(output_directory / SPOOL)
