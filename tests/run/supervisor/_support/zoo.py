"""Children with one behaviour each; run as a script: `zoo.py BEHAVIOUR FOLDER PARENT_PID`.

`zoo.py spare:BEHAVIOUR …` is a spare with that behaviour; `zoo.py broken_spare …` is a spare that fails.

A child reports its readiness and its forks by files in FOLDER, which are named after it and its incarnation.
"""

import faulthandler
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from robbie_mp.base.linux.prctl import die_with_parent
from robbie_mp.run.supervisor.assignment import wait_for_assignment


class Animal:
    """Functions common to all behaviours."""

    def __init__(self, folder: Path, name: str, incarnation: int):
        self.folder = folder
        self.label = f"{name}.{incarnation}"

    def say(self, kind: str, text: str = "") -> None:
        unfinished = self.folder / f"{self.label}.unfinished"
        unfinished.write_text(text)
        unfinished.rename(self.folder / f"{self.label}.{kind}")

    def ready(self) -> None:
        self.say("ready")

    def wait_for_ever(self) -> None:
        while True:
            signal.pause()


def works(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    animal.ready()
    animal.wait_for_ever()


DEADLY_GAIN = 13


def works_as_its_variant(animal: Animal) -> None:
    if f'"gain": {DEADLY_GAIN}' in os.environ.get("ROBBIE_VARIANT", ""):
        sys.exit(1)
    works(animal)


def works_beside_a_thread(animal: Animal) -> None:
    threading.Thread(target=threading.Event().wait, daemon=True).start()
    works(animal)


def ends_at_once(animal: Animal) -> None:
    sys.exit(0)


def fails_at_once(animal: Animal) -> None:
    raise RuntimeError("no such device: /dev/laser")


def ends_when_ready(animal: Animal) -> None:
    animal.ready()


def computes(animal: Animal) -> None:
    """Say when this has used 0.3 s of one processor, however long that takes, and go on."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    os.sched_setaffinity(0, [int(os.environ["PROCESSOR"])])
    animal.ready()
    begin_s = time.process_time()
    while time.process_time() - begin_s < 0.3:
        pass
    animal.say("done")
    while True:  # asleep, it would look hung until its parent sees what it said
        pass


def needs_device(animal: Animal) -> None:
    """Fail unless there is a file that stands for a device."""
    if not (animal.folder / "device").exists():
        sys.exit(6)
    works(animal)


def writes_to_disk(animal: Animal) -> None:
    animal.ready()
    _write_for_ever(animal)


def _write_for_ever(animal: Animal) -> None:
    while True:
        Path(os.environ["DISK"], animal.label).write_text("x")


def forks_writer_and_fails(animal: Animal) -> None:
    """Leave a child behind that writes to the disk."""
    writer = os.fork()
    if writer == 0:  # which leaves it to its parent to say that both are ready
        _write_for_ever(animal)
    animal.say("forked", str(writer))
    animal.ready()
    while not (animal.folder / "end").exists():
        time.sleep(0.002)
    sys.exit(3)


def fails_when_ready(animal: Animal) -> None:
    animal.ready()
    sys.exit(3)


def fails_once(animal: Animal) -> None:
    animal.ready()
    if animal.label.endswith(".1"):
        sys.exit(3)
    works(animal)


def fails_once_running(animal: Animal) -> None:
    """Run for a moment at first; no successor gets ready."""
    if not animal.label.endswith(".1"):
        sys.exit(3)
    animal.ready()
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    signal.signal(signal.SIGALRM, lambda *_: sys.exit(3))
    animal.wait_for_ever()


def fails_in_teardown(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(4))
    animal.ready()
    animal.wait_for_ever()


def crashes(animal: Animal) -> None:
    animal.ready()
    os.kill(os.getpid(), signal.SIGSEGV)


def is_never_ready(animal: Animal) -> None:
    animal.wait_for_ever()


def starts_for_ever(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    animal.say("deaf")
    animal.wait_for_ever()


def ignores_sigterm(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    animal.ready()
    animal.wait_for_ever()


def stops_itself(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    animal.ready()
    os.kill(os.getpid(), signal.SIGSTOP)
    animal.wait_for_ever()


def forks(animal: Animal) -> None:
    """Leave two children behind, one in the session, one a daemon of its own."""
    in_session = os.fork()
    if in_session == 0:
        animal.wait_for_ever()
    reader, writer = os.pipe()
    between = os.fork()
    if between == 0:
        os.setsid()
        daemon = os.fork()
        if daemon == 0:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            animal.wait_for_ever()
        os.write(writer, str(daemon).encode())
        os._exit(0)
    os.waitpid(between, 0)
    animal.say("forked", f"{in_session} {int(os.read(reader, 16))}")
    animal.ready()
    animal.wait_for_ever()


def forks_and_fails(animal: Animal) -> None:
    signal.signal(signal.SIGALRM, lambda *_: os._exit(5))
    signal.alarm(1)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    forks(animal)


def floods(animal: Animal) -> None:
    animal.ready()
    text = b"a line of a flood, and another one follows\n" * 1000
    while True:
        os.write(1, text)


def floods_and_fails(animal: Animal) -> None:
    animal.ready()
    for _ in range(20):
        os.write(1, b"a line of a flood\n" * 1000)
    raise RuntimeError("drowned")


def writes_garbage(animal: Animal) -> None:
    os.write(1, bytes(range(256)) * 40)
    os.write(2, b"\x1b]0;title\x07half a line")
    animal.ready()


def closes_output(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    os.close(1)
    os.close(2)
    animal.ready()
    animal.wait_for_ever()


def notes_signals(animal: Animal) -> None:
    def note(signum: int, _: object) -> None:
        print(signal.Signals(signum).name, flush=True)
        if signum == signal.SIGTERM:
            sys.exit(0)

    for signum in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(signum, note)
    animal.ready()
    animal.wait_for_ever()


def hangs(animal: Animal) -> None:
    faulthandler.enable()
    animal.ready()
    wait_for_a_device_that_is_not_there(animal)


def wait_for_a_device_that_is_not_there(animal: Animal) -> None:
    animal.wait_for_ever()


def ignores_everything(animal: Animal) -> None:
    for signum in (signal.SIGTERM, signal.SIGABRT):
        signal.signal(signum, signal.SIG_IGN)
    animal.ready()
    animal.wait_for_ever()


def prints_its_input(animal: Animal) -> None:
    print(f"input: {sys.stdin.read()!r}", flush=True)
    works(animal)


def works_busily(animal: Animal) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    animal.ready()
    while True:
        print("a line a millisecond", flush=True)
        time.sleep(0.001)


def main() -> None:
    behaviour, folder, parent_pid = sys.argv[1:]
    die_with_parent(int(parent_pid))
    if behaviour == "broken_spare":
        raise ImportError("no numpy here")
    if behaviour.startswith("spare:"):
        assignment = wait_for_assignment()
        if assignment is None:
            return
        name, incarnation = assignment
    else:
        _, name, number = os.environ["ROBBIE_CHILD"].split("/")
        incarnation = int(number)
    act: Callable[[Animal], None] = globals()[behaviour.removeprefix("spare:")]
    act(Animal(Path(folder), name, incarnation))


if __name__ == "__main__":
    main()
