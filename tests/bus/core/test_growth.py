"""Restarts leave nothing behind in a core that grows with their number."""

from itertools import count

from robbie_mp import MessageHandling
from tests._support.growth import blocks_kept
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun

SLOTS = 9


def test_restarts_of_modules_leave_nothing_in_the_core() -> None:
    """Publishers and subscribers are killed in turn, with messages on their way."""
    run = SimulatedRun(SLOTS)
    incarnations = count(1)
    living: dict[int, SimulatedModule] = {}

    def restart(slot: int) -> None:
        if slot in living:
            run.kill(living[slot])
            del run.modules[slot, living[slot].incarnation]
            del living[slot].endpoint  # which refers to it: only the garbage collector would free the two
        module = living[slot] = run.start(slot, next(incarnations))
        module.subscribe(MessageHandling.ALWAYS_DELIVER, "scan")
        module.ready()
        channel = module.advertise("scan")
        module.publish(channel, 1)
        run.run_core()
        for other in living.values():
            other.handle_all()
            other.collect_freed()
        module.publish(channel, 2)  # waits for all of them when the next one dies
        run.run_core()
        run.supervisor_notices()

    def restart_all() -> None:
        for slot in range(1, SLOTS):
            restart(slot)

    assert blocks_kept(restart_all, 50) < 0.5
    assert not run.reports
