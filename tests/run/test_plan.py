"""What the supervisor plans for attached tools."""

import os
from pathlib import Path

from robbie_mp.bus.transport.layout import MAX_OUTSTANDING
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import CoreLimits, MemoryLimits, ModuleSpec, Profile, ToolLimits


def plan(**parts: object) -> RunPlan:
    modules = (ModuleSpec("a", "m:A"), ModuleSpec("b", "m:B", memory=MemoryLimits(4096, 1 << 20)))
    profile = Profile("p", modules, **parts)  # type: ignore[arg-type]
    return RunPlan.of_profile(profile, "d0c7d0c7", Path(), Path(), os.getpid())


def test_all_tools_together_take_at_most_a_quarter_of_the_resources() -> None:
    greedy = ToolLimits(count=8, messages=1 << 20, bytes=1 << 40, credits=4)
    planned = plan(tools=greedy)
    assert 8 * (planned.tool_queue.messages + 4) == MAX_OUTSTANDING // 4
    assert 8 * planned.tool_queue.bytes == (1 << 20) // 4
    small = plan(tools=greedy, core=CoreLimits(handles=64))
    assert small.tool_queue.messages == 1


def test_tool_names_cannot_be_module_names_and_are_saved(tmp_path: Path) -> None:
    planned = plan(tools=ToolLimits(count=2))
    assert planned.names == ["supervisor", "a", "b", "~tool1", "~tool2", "core"]
    planned.save(tmp_path)
    assert RunPlan.load(tmp_path) == planned
