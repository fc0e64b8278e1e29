"""Probes of the review."""
from robbie_mp import MessageHandling
from tests.bus.core._support.simulated_run import CREDIT, SimulatedRun
ALWAYS = MessageHandling.ALWAYS_DELIVER


def setup(run, *, latched=False):
    """1 paces itself, 4 publishes on another topic now and then; 2 handles both; 3 (yields) stands still."""
    paced = run.start(1); fast = paced.advertise(is_latched=False); 
    early = paced.advertise("map", "test_msgs/msg/Map", is_latched=latched)
    paced.ready()
    other = run.start(4); slow = other.advertise("o", "test_msgs/msg/O"); other.ready()
    sink = run.start(2); sink.subscribe(); sink.subscribe(ALWAYS, "o", "test_msgs/msg/O"); sink.subscribe(ALWAYS, "map", "test_msgs/msg/Map"); sink.ready()
    box = run.start(3); box.subscribe_by_patterns("*"); box.ready()
    run.run_core()
    return paced, fast, early, other, slow, sink, box


def drain(run, sink):
    for _ in range(100):
        run.run_core()
        if not sink.handle_all():
            break
    run.run_core()


def test_plain():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT + 4):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    drain(run, sink)
    paced.collect_freed()
    paced.endpoint.wake_after_freed(2)
    before = paced.wakeups
    drain(run, sink)
    assert paced.wakeups > before


def test_other_publisher_at_head():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    assert other.publish(slow, 1); run.run_core(); sink.handle_all()
    for v in range(20):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    drain(run, sink)
    paced.collect_freed()
    paced.endpoint.wake_after_freed(2)
    before = paced.wakeups
    drain(run, sink)
    assert paced.wakeups > before, "20 messages only wait for the box, behind one of another publisher"


def test_latched_at_head():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run, latched=True)
    for v in range(CREDIT):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    assert paced.publish(early, 1); run.run_core(); sink.handle_all()
    for v in range(20):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    drain(run, sink)
    paced.collect_freed()
    paced.endpoint.wake_after_freed(2)
    before = paced.wakeups
    drain(run, sink)
    assert paced.wakeups > before, "20 messages only wait for the box, behind its own latched one"


def test_pinned_at_head():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    assert paced.publish(fast, 1); run.run_core()
    kept = sink.take(); sink.endpoint.done(kept) if hasattr(sink.endpoint, "done") else None
    for v in range(20):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    drain(run, sink)
    paced.collect_freed()
    paced.endpoint.wake_after_freed(2)
    before = paced.wakeups
    drain(run, sink)
    assert paced.wakeups > before, "20 messages only wait for the box, behind one that the sink keeps"


def test_last_other_subscriber_dies():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    for v in range(8):
        assert paced.publish(fast, v); run.run_core()
    paced.collect_freed()
    paced.endpoint.wake_after_freed(2)
    run.run_core()
    before = paced.wakeups
    run.kill(sink)
    run.gone(sink, clean=False)
    run.run_core()
    assert paced.wakeups > before, "the sink is gone for good: only the box has them"


def test_published_after_the_wish():
    """A module may wish first, and publish then (its thread, or the rest of its tick)."""
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    alone = paced.advertise("alone", "test_msgs/msg/Alone"); run.run_core()
    for v in range(CREDIT):
        assert paced.publish(alone, v); run.run_core()
    paced.endpoint.wake_after_freed(2)
    run.run_core()
    before = paced.wakeups
    for v in range(8):
        assert paced.publish(alone, v); run.run_core()
    assert paced.wakeups > before, "8 messages only wait for the box"


def test_two_that_yield():
    from dataclasses import replace
    run = SimulatedRun(slots=6, yielding=3)
    run.limits[4] = replace(run.limits[4], yields=True)
    run.restart_core()
    paced = run.start(1); fast = paced.advertise(); paced.ready()
    for slot in (3, 4):
        box = run.start(slot); box.subscribe_by_patterns("*"); box.ready()
    run.run_core()
    for v in range(CREDIT + 8):
        assert paced.publish(fast, v); run.run_core()
    paced.endpoint.wake_after_freed(2)
    before = paced.wakeups
    run.run_core()
    assert paced.wakeups > before, "both yield"


def test_last_messages_of_a_crashed_publisher():
    """Its last record is its wish: the box loses what it published before the crash, for nobody."""
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    alone = paced.advertise("alone", "test_msgs/msg/Alone"); run.run_core()
    for v in range(CREDIT + 8):
        assert paced.publish(alone, v); run.run_core()
    paced.endpoint.wake_after_freed(5)   # the core reads it only when it reclaims the dead module
    run.kill(paced)
    assert sum(run.counts(row)["dropped"] for row in range(8)) == 0


def test_faulted_publisher_with_a_wish():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT + 8):
        assert paced.publish(fast, v); run.run_core()
    paced.endpoint.wake_after_freed(50)
    paced.endpoint.send(99)
    run.run_core()
    assert run.reports
    drain(run, sink)
    assert sum(run.counts(row)["dropped"] for row in range(8)) == 0


def test_fulfilled_wish_drops_nothing():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT + 8):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    drain(run, sink)
    box.handle_all(); run.run_core()
    paced.endpoint.wake_after_freed(2)
    run.run_core()
    drain(run, sink)
    assert sum(run.counts(row)["dropped"] for row in range(8)) == 0


def test_wish_beyond_what_can_be_freed_takes_all():
    run = SimulatedRun(slots=6, yielding=3)
    paced, fast, early, other, slow, sink, box = setup(run)
    for v in range(CREDIT + 8):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all()
    drain(run, sink)
    paced.endpoint.wake_after_freed((1 << 60))
    run.run_core()
    for v in range(20):
        assert paced.publish(fast, v); run.run_core(); sink.handle_all(); run.run_core()
    dropped = [run.counts(row)["dropped"] for row in range(8)]
    box.handle_all()
    assert sum(dropped) == 0, dropped
