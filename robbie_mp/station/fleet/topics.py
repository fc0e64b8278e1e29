"""What robots of a team tell one another, and under which topics."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robbie_mp.run.plan import RunPlan

LINK_CLASS = "robbie_mp.connect.link.module:Link"
SUMMARY = "robot_summary"
PREVIEW = "preview"
"""Of small pictures, one a second, for pages of other robots."""


def is_preview(topic: str) -> bool:
    """Whether the pictures of a topic are those that a robot sends to the pages of others."""
    return topic.rpartition("/")[2] == PREVIEW


def has_team(plan: RunPlan) -> bool:
    """Return whether a robot has a link that tells the topics of other robots from its own."""
    return any(
        one.class_path == LINK_CLASS and bool(one.settings.get("prefix_topics")) for one in plan.modules
    )
