"""The campaign's robot: its publishers, its subscribers, and their topics."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

MEGABYTE = 1 << 20
LARGEST_BYTES = 2 * MEGABYTE
STEADY: dict[str, dict[str, Any]] = {
    "sink_all": {"topics": [""]},
    "sink_small": {"topics": ["small", "burst"]},
    "sink_large": {"topics": ["large", "mixed"]},
    "sink_newest": {"topics": [""], "newest": True},
    "sink_newest_large": {"topics": ["large", "loaned"], "newest": True},
    "holder": {"topics": ["large", "loaned", "relay_back"], "hold": 8},
    "relay": {"topics": ["small", "mixed"], "relay_every": 4, "largest_bytes": 65536},
    "relay_back": {"topics": ["relay"], "newest": True, "relay_every": 1},
    "small": {"burst": 2, "period_s": 0.02},
    "large": {"burst": 1, "period_s": 0.1, "smallest_bytes": MEGABYTE // 4, "largest_bytes": LARGEST_BYTES},
    "mixed": {"burst": 1, "period_s": 0.04, "largest_bytes": LARGEST_BYTES},
    "loaned": {"burst": 1, "period_s": 0.1, "largest_bytes": LARGEST_BYTES, "loans": True,
               "outstanding_limit": 40},
}  # fmt: skip
OVERLOADED: dict[str, dict[str, Any]] = {
    "sink_slow": {"topics": ["small", "large", "burst"], "handle_s": 0.01},
    "burst": {"burst": 60, "period_s": 0.7, "largest_bytes": 1024},
}
CAMERA, VIEWER, STOPPED_VIEWER, HOARDER = "camera", "viewer", "viewer_stopped", "hoarder"
IMAGE_BYTES = 1920 * 1080 * 3
WITH_CAMERA: dict[str, dict[str, Any]] = {
    VIEWER: {"topics": [CAMERA]},
    STOPPED_VIEWER: {"topics": [CAMERA]},
    HOARDER: {"topics": [CAMERA], "hold": 60, "hoards": True},
    CAMERA: {"burst": 1, "period_s": 1 / 30, "smallest_bytes": IMAGE_BYTES, "largest_bytes": IMAGE_BYTES},
}
"""A camera and its three viewers, with the defaults for memory and queues."""
SHORT_QUEUE = {"messages": 100, "bytes": 16 * MEGABYTE}
"""Queue of the slow subscriber, so short that it is full most of the time."""
MEMORY = {"segment_bytes": MEGABYTE, "limit_bytes": 96 * MEGABYTE, "checkpoint_bytes": 4096}
DEFAULT_MEMORY = {"checkpoint_bytes": 4096}
RESTART = {"max_restarts": 1_000_000, "backoff_s": 0.01, "backoff_cap_s": 0.1, "stable_after_s": 1.0}


def roles(*, overloaded: bool, camera: bool = False) -> dict[str, dict[str, Any]]:
    """Return the settings of each participant, subscribers first.

    Args:
        overloaded: include the publisher of bursts and the slow subscriber, whose queue is always full.
        camera: include the camera, with images of 6.2 MB at 30 Hz, and its three viewers.
    """
    return STEADY | (OVERLOADED if overloaded else {}) | (WITH_CAMERA if camera else {})


def publishers(settings: dict[str, dict[str, Any]]) -> list[str]:
    """Return the names of the publishers."""
    return [name for name, part in settings.items() if part.get("burst") or part.get("relay_every")]


def write_workspace(
    folder: Path, settings: dict[str, dict[str, Any]], others: Mapping[str, dict[str, Any]]
) -> None:
    """Write a workspace whose profile `campaign` is the robot.

    Args:
        folder: folder of the workspace.
        settings: settings of the participants, by name.
        others: further modules, as in a profile.
    """
    known = {*publishers(settings), ""}
    modules = dict(others)
    for name, part in settings.items():
        present = part | {"topics": [topic for topic in part.get("topics", ()) if topic in known]}
        modules[name] = {
            "class": "tools.kill_campaign.modules:Participant",
            "settings": present,
            "restart": RESTART,
            "memory": DEFAULT_MEMORY if name in WITH_CAMERA else MEMORY,
        }
    if "sink_slow" in modules:
        modules["sink_slow"]["queue"] = SHORT_QUEUE
    (folder / "profiles").mkdir(parents=True)
    # Its clips of all these kills would be latched messages of their own; tests/logs/black_box kills it.
    text = yaml.safe_dump({"modules": modules, "black_box": False}, sort_keys=False)
    (folder / "profiles" / "campaign.yaml").write_text(text)
