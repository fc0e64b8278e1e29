"""Does the same again and again over the hot path in C, and requires that no references gather.

    python -m tests.bus.hot._support.reference_counts FOLDER SOURCES [PLAY...]

SOURCES is the folder of the sources in C; a test gives some with a defect. The plays are methods of `Plays`.

A reference too many keeps its object for ever, which the count of the interpreter's memory blocks shows. If
the object lives on anyway, such as None or a class, only its own count shows it, which is also what shows a
reference too few.
"""

import contextlib
import gc
import logging
import sys
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from robbie_mp import MessageHandling, RobbieError
from robbie_mp.bus.transport.words import WORD_BYTES
from tests.bus.hot._support.build import HOT, fused_module

WARM_UP = 20
"""Rounds after which caches, also those of numpy, hardly grow any more."""
ROUNDS = 12
"""Rounds of a window."""
MAX_WINDOWS = 10
"""Windows after which what still grows is no cache; most plays need one or two."""
LEAST = 2
"""References or blocks more in each round that count; every play does everything several times."""
LASTING: list[object] = [None, True, False, NotImplemented, Ellipsis, (), "", b""]
"""Objects that live as long as the interpreter, but that the garbage collector does not list."""

WRONG: tuple[tuple[object, ...], ...] = (
    (), (None,), (2**64,), (1, 2, 3), ("", "", ""), ("",) * 7, (-1,) * 7, ([],) * 8, (None,) * 10,
)  # fmt: skip
"""Arguments that few methods take, or none."""


def references() -> dict[str, int]:
    """Count the references to objects of each type."""
    gc.collect()
    counted: dict[str, int] = {}
    objects = gc.get_objects()
    for each in objects:
        name = f"references to {type(each).__name__}"
        counted[name] = counted.get(name, 0) + sys.getrefcount(each)
    del objects
    for each in LASTING:
        counted[f"references to {each!r}"] = sys.getrefcount(each)
    return counted


def gathered(play: Callable[[], object]) -> str:
    """Say what gathers if something is done again and again; '' if nothing does.

    Caches fill at times of their own choosing. Only what grows, or shrinks, in each window gathers.
    """
    logging.disable()
    for _ in range(WARM_UP):
        play()
    gathering: dict[str, int] = {}
    for window in range(MAX_WINDOWS):
        more = _more(play)
        if window > 0:
            more = {
                name: min(gathering[name], more[name], key=abs) for name in gathering.keys() & more.keys()
            }
        gathering = more
        if not gathering:
            break
    return ", ".join(f"{number / ROUNDS:+g} {name}" for name, number in sorted(gathering.items()))


def _more(play: Callable[[], object]) -> dict[str, int]:
    """Do it ROUNDS times; return of what there is much more then, or less."""
    before, blocks = references(), sys.getallocatedblocks()
    for _ in range(ROUNDS):
        play()
    gc.collect()
    more = {"blocks of memory": sys.getallocatedblocks() - blocks}
    for name, number in references().items():
        more[name] = number - before.get(name, 0)
    return {name: number for name, number in more.items() if abs(number) >= LEAST * ROUNDS}


class Plays:
    """Plays over a build of the sources in C."""

    def __init__(self, built: Any):
        from tests.bus.hot._support.exchange import parcel_class  # noqa: PLC0415 (uses the build that was loaded)

        self.built = built
        self.parcel: Any = parcel_class(built)

    def routing(self) -> None:
        """Histories and robots, whose core and modules die, and loops of the core."""
        from tests.bus.hot._support.histories import crowd, history  # noqa: PLC0415

        for number in range(6):
            history(number)
            crowd(number)

    def waking(self) -> None:
        """A wake-up, waited for with and without success, also by the core."""
        for _ in range(5):
            self._wake()

    def _wake(self) -> None:
        from tests.bus.core._support import simulated_run  # noqa: PLC0415

        posts, asleep = (memoryview(bytearray(WORD_BYTES)) for _ in range(2))
        opened = self.built.Wakeup(posts, asleep, 0)
        with contextlib.suppress(ValueError):
            self.built.Wakeup(posts, asleep, 1)
        opened.post()
        assert opened.has_posts and opened.wait(1.0) and not opened.wait(0) and not opened.wait(0.001)
        router: Any = (run := simulated_run.SimulatedRun()).router
        publisher, channel, subscribers = simulated_run.connected(run, MessageHandling.ALWAYS_DELIVER)
        for value in range(3):
            publisher.advertise(f"other {value}")  # which C leaves to Python
            assert publisher.publish(channel, value)
            opened.post()
            assert router.work_alone(opened.post, 0.0)
            assert subscribers[0].handle_all() == [value]
        opened.close()
        with contextlib.suppress(Exception):
            opened.post()

    def exchanging(self) -> None:
        """Messages of all sizes, kept as arrays, parts of arrays and not; loans; damaged ones; ticks."""
        from tests.bus.hot._support import exchange as exchanges  # noqa: PLC0415

        exchanges._runs = count()  # other names of files would gather in caches of Python's library
        for keep in range(4):
            exchange = exchanges.Exchange(self.built, self.parcel)
            exchange.keep(keep)
            exchange.set_period((None, 1, 1e-9, 1e9)[keep])  # one is longer than what C computes with
            exchange.await_room(0)
            for size in map(int, ("0", "60", "5000", "40000")):  # large ones are new objects
                for topic in range(3):
                    exchange.publish(topic, size)
                exchange.publish_damaged()
                exchange.core()
                exchange.take_turns(3)
                exchange.outstanding()
                self._lend(exchange, size)
                exchange.core()
                exchange.take_turns(2)
            exchange.drop(1)
            exchange.restart_core()
            exchange.core()
            exchange.close()
            vars(exchange).clear()

    def _lend(self, exchange: Any, size: int) -> None:
        with exchange.outbox.loan(self.parcel, "left", {"number": 1, "data": size}) as lent:
            lent.data[:] = 1
        with contextlib.suppress(ZeroDivisionError), exchange.outbox.loan(self.parcel, "", {"data": size}):
            raise ZeroDivisionError

    def encoding(self) -> None:
        """Encode and decode the random messages of the codec's fuzzer."""
        from tests.messages._support.codec_fuzz import fuzz  # noqa: PLC0415

        fuzz(1, 300)

    def misuse(self) -> None:
        """Wrong arguments, and ends whose memory was let go."""
        for _ in range(10):
            self._misuse()

    def _misuse(self) -> None:
        from robbie_mp.bus.transport.ring import RingPlace  # noqa: PLC0415

        built = self.built
        for name, made in vars(built).items():
            if isinstance(made, type) and name != "Words":
                for arguments in WRONG:
                    with contextlib.suppress(TypeError, ValueError, OSError, AttributeError, OverflowError):
                        made(*arguments)
        words, tail = built.Words(34), built.Words(1)
        place = RingPlace(words, 0, 2, 4, tail, 0)
        for ends in ((built.RingWriter, built.RingReader), (built.NumberRingWriter, built.NumberRingReader)):
            words[0] = tail[0] = 0
            writer, reader = (end(place) for end in ends)
            for end in (writer, reader):
                for name in dir(type(end)):
                    if not name.startswith("_") and callable(getattr(type(end), name)):
                        self._call_wrongly(getattr(end, name))
            words[0] = 1000
            with contextlib.suppress(RobbieError):
                reader.take_all() if hasattr(reader, "take_all") else reader.waiting()
            writer.close()
            reader.disown()
            with contextlib.suppress(Exception):
                writer.push(*range(7))
            with contextlib.suppress(Exception):
                reader.take_all()

    def _call_wrongly(self, method: Callable[..., object]) -> None:
        if method.__name__ in ("close", "disown"):
            return
        for arguments in WRONG:
            with contextlib.suppress(TypeError, OverflowError, RobbieError):
                method(*arguments)


PLAYS = ("waking", "misuse", "encoding", "exchanging", "routing")


def main() -> None:
    """Do everything; the exit code is 1 if anything gathers."""
    folder, sources, *chosen = sys.argv[1:]
    built: Any = fused_module(Path(folder), "-O0", hot=Path(sources))
    from robbie_mp.bus import _hot  # noqa: PLC0415
    from robbie_mp.bus._hot.sources import digest  # noqa: PLC0415

    built.SOURCES = digest(HOT)
    sys.modules["robbie_mp.bus._hot.native"] = _hot.native = built
    from robbie_mp.messages.message import _NATIVE  # noqa: PLC0415 (chosen at import)
    from tests.bus.core._support.simulated_run import SimulatedRun  # noqa: PLC0415
    from tests.bus.hot._support.memory import FusedMemory  # noqa: PLC0415

    assert id(_NATIVE) == id(built)
    SimulatedRun.memory = FusedMemory(built, with_c=True)
    plays, failed = Plays(built), False
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "monotonic_ns", built.tick)
        for name in chosen or PLAYS:
            found = gathered(getattr(plays, name))
            failed |= bool(found)
            print(f"{name}: {found or 'nothing gathers'}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
