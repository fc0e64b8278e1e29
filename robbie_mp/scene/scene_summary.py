"""Describes a scene file, as `robbie info` shows it."""

from collections import Counter
from pathlib import Path

from robbie_mp.scene.described import SceneNotes
from robbie_mp.scene.scene_file import read_scene


def describe_scene(file: Path) -> dict[str, str]:
    """Return what a scene file holds, with the files that it includes, as labels with texts.

    Raises:
        SceneFileError: it cannot be used.
    """
    notes = SceneNotes()
    nodes = read_scene(file, notes)
    kinds = Counter(node.joint.type for node in nodes if node.joint is not None)
    left_out = (f"{text} ({count})" for text, count in notes.balance.left_out.items())
    return {
        "roots": ", ".join(node.name for node in nodes if node.parent is None),
        "nodes": str(len(nodes)),
        "joints": ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())) or "none",
        "left out": "; ".join([*left_out, *notes.warnings]) or "nothing",
    }
