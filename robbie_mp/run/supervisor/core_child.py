"""The core as a child: connects the router to the run's memory."""

import logging

from robbie_mp.base.linux.bus_error import surviving_truncation
from robbie_mp.bus._hot.choice import native
from robbie_mp.bus.core.process import CoreProcess
from robbie_mp.bus.core.router import SlotLimits
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.run.plan import CORE, SUPERVISOR_MEMORY_BYTES, TOOL_MEMORY_BYTES, RunPlan
from robbie_mp.run.profile.model import BLACK_BOX, QueueLimits
from robbie_mp.run.run_clock import RunClock
from robbie_mp.run.supervisor.scheduling import apply_scheduling

SUPERVISOR_QUEUE = SlotLimits(queue_messages=1000, queue_bytes=1 << 20, memory_bytes=SUPERVISOR_MEMORY_BYTES)


def run_core(plan: RunPlan) -> None:
    """Route messages until SIGTERM."""
    modules = [
        _slot(module.queue, memory_bytes=module.memory.limit_bytes, yields=module.name == BLACK_BOX)
        for module in plan.modules
    ]
    tool = _slot(plan.tool_queue, plan.tools.credits, memory_bytes=TOOL_MEMORY_BYTES, is_tool=True)
    message_bytes = max((module.memory.limit_bytes for module in plan.modules), default=0)
    latched = SlotLimits(plan.core.latched_messages, plan.core.latched_bytes)
    slots = [SUPERVISOR_QUEUE, *modules, *[tool] * plan.tools.count, latched]
    scheduling = plan.core.scheduling
    apply_scheduling(scheduling, logging.getLogger(CORE))
    message_bytes = max(message_bytes, TOOL_MEMORY_BYTES)
    spin_s, lockstep = scheduling.spin_us / 1e6, plan.clock.lockstep
    charged_ns = RunClock.attach(plan.run_id).now_ns if plan.clock.charge else None
    core = CoreProcess(
        plan.run_id,
        plan.sizes,
        slots,
        message_bytes,
        spin_s,
        lockstep=lockstep,
        native=native(),
        charged_ns=charged_ns,
    )
    with surviving_truncation(f"{SHARED_MEMORY / names.folder(plan.run_id)}/"):
        core.run()


def _slot(
    queue: QueueLimits,
    credit: int | None = None,
    *,
    memory_bytes: int,
    is_tool: bool = False,
    yields: bool = False,
) -> SlotLimits:
    return SlotLimits(
        queue.messages,
        queue.bytes,
        credit,
        in_flight_bytes=queue.in_flight_bytes,
        memory_bytes=memory_bytes,
        is_tool=is_tool,
        yields=yields,
    )
