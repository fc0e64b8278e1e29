"""Processor time of the core for one message, without other processes: python micro.py c|python N"""
import sys, time
from array import array
from robbie_mp import MessageHandling
from robbie_mp.bus._hot.choice import native
from robbie_mp.bus.transport import layout
from tests.bus.core._support import simulated_run as sr
import robbie_mp.bus.core.router, robbie_mp.bus.core.ledger
form, n = sys.argv[1], int(sys.argv[2])
class Mem:
    def __init__(self, nat): self.native = nat
    def fuse(self):
        from tests.bus.core._support.memory import Fuse
        return Fuse()
    def zeros(self, count):
        return memoryview(bytearray(8*count)).cast("Q")
    def map(self, words, fuse, segment=None, log=None):
        return wrap(words)
    def look_at(self, words): return wrap(words)
    def note_wake(self, slot): pass
def wrap(words):
    if form == "cython":
        from robbie_mp.bus.transport.shared_words import SharedWords
        return SharedWords(words)
    class M:  # only close is needed
        pass
    return words[:]
import builtins
nat = native()
assert nat
sr.SimulatedRun.native_modules = nat
sr.SimulatedRun.memory = Mem(nat if form == "c" else None)
memoryview_close = lambda self: None
def connected(batch):
    run = sr.SimulatedRun(handles=256)
    p, ch, (s,) = sr.connected(run, MessageHandling.ALWAYS_DELIVER)
    return run, p, ch, s
run, p, ch, s = connected(1)
clock = time.perf_counter_ns
best = []
for _ in range(7):
    pub = rel = 0
    for i in range(n):
        p.endpoint.freed()
        assert p.publish(ch, 1, 64)
        t0 = clock(); run.router.run_round(); pub += clock() - t0
        d = s.take(); s.endpoint.release(d)
        t0 = clock(); run.router.run_round(); rel += clock() - t0
    best.append((pub / n, rel / n))
t0=clock(); [clock() for _ in range(1000)]; over=(clock()-t0)/1000
print(form, "publish %.0f ns  release %.0f ns  (clock %.0f)" % (min(b[0] for b in best)-over, min(b[1] for b in best)-over, over), robbie_mp.bus.core.ledger.__file__[-12:])
