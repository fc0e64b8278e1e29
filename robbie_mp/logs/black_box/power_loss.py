"""Makes a clip of the spool that a power cut has left."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

from robbie_mp.base.visible_text import one_line
from robbie_mp.logs.black_box.clip_folder import AboutClip, ClipFolder, clip_name, saved_clips
from robbie_mp.logs.black_box.ring import last_message_s, ring_home, ring_parts
from robbie_mp.logs.black_box.spool import ABOUT, LOG, AboutSpool, locked, remove_spool
from robbie_mp.logs.recording.format import part_path
from robbie_mp.logs.recording.mcap_records import MAGIC

POWER_LOST = "power lost"


def recover(spools: Iterable[Path]) -> list[str]:
    """Make a clip of each spool whose run is dead, and remove the spool; return what to tell the user.

    A run that still has its shared memory is not dead, or is one of those that `salvage` sees to.
    """
    told: list[str] = []
    for folder in spools:
        with contextlib.suppress(OSError), locked(folder) as is_dead:
            about = AboutSpool.read(folder)
            if not is_dead or (about is not None and ring_home(about.run_id).exists()):
                continue
            if about is None:
                if (folder / ABOUT).exists():
                    told.append(f"{folder / ABOUT} cannot be read, so no clip is made; remove {folder}")
                continue
            told += _rescue(folder, about)
            remove_spool(folder)
    return [one_line(line) for line in told]


def _rescue(folder: Path, about: AboutSpool) -> list[str]:
    log = folder / LOG
    numbers = [number for number in ring_parts(log) if part_path(log, number).stat().st_size > len(MAGIC)]
    if not numbers:
        return [f"run {about.run_id} lost its power before anything was on the disk"]
    output = folder.parent
    clips = ClipFolder(output, about.clips_bytes)
    torn = [clip.folder for clip in saved_clips([clips.path]) if clip.about is None]
    end_s = last_message_s(log) or max(part_path(log, number).stat().st_mtime for number in numbers)
    name = clip_name(POWER_LOST, [], end_s)  # the same one if this is interrupted
    told = [f"clip {one} is not whole: run {about.run_id} lost its power meanwhile" for one in torn]
    try:
        for number in numbers:
            clips.add_part(name, part_path(log, number), number)
        clips.finish(name, AboutClip(about.run_id, about.profile, [POWER_LOST], [end_s], 0, ""))
    except (OSError, LookupError) as error:
        return [*told, f"the last messages of run {about.run_id} are lost: {error}"]
    return [*told, f"run {about.run_id} lost its power, and has left a clip: {clips.path / name}"]
