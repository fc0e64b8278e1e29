"""The core's process: takes over what a dead core left, and then routes until SIGTERM."""

import gc
import logging
import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from types import FrameType

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.core.members import SUPERVISOR_SLOT, LinkMemory, RouterLimits
from robbie_mp.bus.core.native_router import NativeRouter, make_router
from robbie_mp.bus.core.router import SlotLimits
from robbie_mp.bus.core.supervisor_watch import SupervisorWatch
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.layout import HotPath, SegmentKind
from robbie_mp.bus.transport.run_memory import IncarnationMemory, RingSizes, attach_core_wakeup
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.tables import CoreTables

HEARTBEAT_S = 0.2


class CoreProcess:
    """The router with its memory and its loop.

    Args:
        run_id: the run it belongs to.
        sizes: capacities of the rings.
        slots: bounds of each slot's queue.
        message_bytes: size of the largest message that any module's memory can hold.
        spin_s: how long to poll for the next message before sleeping.
        lockstep: whether one message is handled at a time in the whole run.
        native: what is written in C; None: Python does it.
        charged_ns: in lockstep, the run's time, if modules are charged for the time of their handlers.
    """

    def __init__(
        self,
        run_id: str,
        sizes: RingSizes,
        slots: Sequence[SlotLimits],
        message_bytes: int,
        spin_s: float = 0.0,
        *,
        lockstep: bool = False,
        native: Native | None = None,
        charged_ns: Callable[[], int] | None = None,
    ):
        self._run_id = run_id
        self._native = native
        self._segment = Segment.attach(names.core(run_id), SegmentKind.CORE, write=True)
        self._words = self._segment.words
        self._wakeup = attach_core_wakeup(run_id, self._segment, native)
        self._wakeup.spin_s = spin_s
        in_c = native is not None and not lockstep
        self._words[layout.CORE_HOT_PATH] = HotPath.C if in_c else HotPath.PYTHON
        self._stopping = False
        self._supervisor: SupervisorWatch
        self._router = make_router(
            native,
            CoreTables.attach(self._words),
            RouterLimits(sizes.records, sizes.credit, message_bytes),
            slots,
            self._connect,
            logging.getLogger("core").error,
            lockstep=lockstep,
            charged_ns=charged_ns,
        )

    def run(self) -> None:
        """Route until SIGTERM.

        Raises:
            SystemExit: the supervisor makes no progress. Without messages, the robot stands; a supervisor
                that continues starts the next core.
        """
        signal.signal(signal.SIGTERM, self._on_terminate)
        self._router.recover()
        self._router.module_up(SUPERVISOR_SLOT, 1)
        gc.freeze()  # imported objects stay, so the garbage collector need not visit them again
        router, words = self._router, self._words
        run_round, sleep = router.run_round, self._sleep
        if isinstance(router, NativeRouter) and not self._wakeup.spin_s:
            sleep = partial(self._work_alone, router)
        watch = self._supervisor
        while not self._stopping:
            now_ns = time.monotonic_ns()
            words[layout.CORE_HEARTBEAT_NS] = now_ns  # here, as it never sleeps in a flood
            if now_ns >= watch.next_look_ns and watch.look(now_ns):
                sys.exit("the supervisor makes no progress, and nothing may move without it")
            # One look is enough: a module that writes later also posts later, which ends the wait at once.
            if run_round() or router.before_sleep():
                continue
            sleep()

    def _sleep(self) -> None:
        words = self._words
        words[layout.CORE_WAKEUPS] = words[layout.CORE_WAKEUPS] + 1
        self._wakeup.wait(HEARTBEAT_S)

    def _work_alone(self, router: NativeRouter) -> None:
        if not router.work_alone(self._wakeup.post, HEARTBEAT_S):
            self._sleep()

    def _on_terminate(self, _signal: int, _frame: FrameType | None) -> None:
        self._stopping = True

    def _connect(self, slot: int, incarnation: int) -> LinkMemory:
        memory = IncarnationMemory.attach_as_core(self._run_id, slot, incarnation, self._native)
        if slot == SUPERVISOR_SLOT:
            self._supervisor = SupervisorWatch(memory.out.words, logging.getLogger("core").error)
        return LinkMemory(incarnation, memory.out.words, memory.into.words, memory.wakeup.post, memory.close)
