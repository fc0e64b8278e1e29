"""The history that a module's process keeps of itself, for the capsule of its crash."""

import contextlib
import json
import logging
import os
import random
import secrets
import sys
import time
from pathlib import Path

import numpy as np

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.address_space import address_space_bytes
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.checkpoint.image import ImageLayout, lay_out
from robbie_mp.bus.checkpoint.keeper import CheckpointKeeper
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.history import (
    GROWTH_BYTES,
    LARGEST_SHARE,
    ROOM_FACTOR,
    Event,
    OwnHistory,
    free_bytes,
    history_words,
)
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.module.membership import Membership
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.supervisor.imported_files import robot_files

AT_FIRST_BYTES = 2 * GROWTH_BYTES
"""Memory of a history when its module starts; it then grows."""
RANDOM_PERIOD_S = 1.0
"""Least time between two records of the state of the generators of random numbers."""
START_FORMAT = 1


def open_history(
    run_id: str, slot: int, incarnation: int, ring_bytes: int | None, native: Native | None
) -> OwnHistory | None:
    """Make the history of a module's process; None: the profile wants none, or there is little memory."""
    if not ring_bytes:
        return None
    try:
        if free_bytes() < ROOM_FACTOR * AT_FIRST_BYTES:
            return None
        name, words = names.history(run_id, slot, incarnation), history_words(ring_bytes)
        segment = Segment.create(name, words, SegmentKind.HISTORY, slot, incarnation, AT_FIRST_BYTES)
    except (OSError, RobbieError) as error:
        logging.getLogger("robbie.history").warning("a crash will have no capsule: %s", error)
        return None
    return OwnHistory(segment, native)


def begin_history(
    history: OwnHistory,
    plan: RunPlan,
    place: Membership,
    planned: ModuleSpec,
    settings: dict[str, object],
    checkpoints: CheckpointKeeper,
) -> None:
    """Write what the module begins with, and make its random numbers repeatable."""
    seed = secrets.randbits(32)
    random.seed(seed)
    np.random.seed(seed)
    history.write_start(
        {
            "format": START_FORMAT,
            "module": planned.name,
            "class": planned.class_path,
            "settings": settings,
            "topics": dict(planned.topics),
            "namespace": planned.namespace,
            "run": plan.run_id,
            "profile": plan.profile_name,
            "workspace": plan.workspace,
            "incarnation": place.peers.incarnation,
            "seed": seed,
            "hash_seed": os.environ.get("PYTHONHASHSEED", "random"),
            "lost": checkpoints.lost,
            "is_restored": checkpoints.restored is not None,
            "lockstep": plan.clock.lockstep,
            "process_bytes": planned.memory.process_bytes,
            "address_space_bytes": address_space_bytes(),
            "started_ns": time.time_ns(),
            "monotonic_ns": time.monotonic_ns(),
            "robbie": plan.version,
            "python": sys.version.split()[0],
            "files": _files(plan.workspace),
        }
    )
    if checkpoints.restored is not None:
        _append_image(history, Event.RESTORED, lay_out(checkpoints.restored))


def record_checkpoint(history: OwnHistory, image: ImageLayout) -> None:
    """Record a checkpoint, and the generators' state if the module's start is no longer in the history."""
    _append_image(history, Event.CHECKPOINT, image)
    now_s = time.monotonic()
    if history.has_wrapped and now_s - history.random_recorded_s >= RANDOM_PERIOD_S:
        history.random_recorded_s = now_s
        history.append(Event.RANDOM, 0, 0, 0, 0, 0, json.dumps(_random_state()).encode())


def _append_image(history: OwnHistory, kind: Event, image: ImageLayout) -> None:
    data = bytearray()
    if image.size <= history.bytes // LARGEST_SHARE:
        data = bytearray(image.size)
        image.write(memoryview(data), 0, time.time_ns())
    history.append(kind, 0, image.size, 0, 0, 0, data)


def _random_state() -> list[object]:
    state = np.random.get_state(legacy=True)
    return [random.getstate(), [np.asarray(one).tolist() for one in state]]


def _files(workspace: str) -> dict[str, list[int]]:
    """Return time and size of the files of the workspace, and of the stock robots, that are imported."""
    found = {}
    for file in robot_files(workspace):
        with contextlib.suppress(OSError):
            stat = os.stat(file)
            found[str(Path(file))] = [stat.st_mtime_ns, stat.st_size]
    return found
