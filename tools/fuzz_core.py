"""Lets a coverage-guided fuzzer write garbage into a module's memory, and watches the core and the others.

    python -m tools.fuzz_core [--seconds N] [--input FILE]

Run it from a checkout (the simulated run is that of `tests/core`), with the extra `fuzz` installed. The bytes
that atheris (libFuzzer for Python) makes up decide what a hostile module writes where in its segment, what
it and two innocent modules do in between, and when the core dies. A finding is an exception that leaves the
core, an input that takes longer than 20 s, a message that the innocent did not get once and in order, or
books that do not balance; its input is kept in the current directory, and `--input` runs it again.
"""

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import atheris

# Only what is imported in here has its branches counted.
with atheris.instrument_imports(include=["robbie_mp.core", "robbie_mp.transport"]):
    from robbie_mp.transport import layout
    from robbie_mp.transport.records import MessageHandling, Outbound
    from robbie_mp.transport.words import WORD_MAX
    from tests.core.siege import HOSTILE_SLOT, Siege
    from tests.core.simulated_run import RING_RECORDS, TYPE

FUZZ_ONLY = "--fuzz-here"
MAX_STEPS = 100
MAX_INPUT_BYTES = 2048
HANG_S = 20
START_AND_END_S = 60.0
FINDING_EXIT = 1

SOURCES = [layout.pack_source(slot, 0, 1) for slot in (0, 1, HOSTILE_SLOT)]
EDGES = [*SOURCES, 256, 2**16, 2**31, 2**32, 2**63, WORD_MAX - 1, WORD_MAX]
CONTROL_WORDS = [*range(layout.OUT_HEAD, layout.OUT_READY + 1), layout.OUT_AWAITED_FREED]
KINDS = [int(kind) for kind in Outbound]


class Attack:
    """One input: its bytes are read as steps until they are used up."""

    def __init__(self, data: bytes):
        self.bytes = atheris.FuzzedDataProvider(data)
        self.siege = Siege()
        self.steps = [
            self.record, self.record, self.scribble, self.scribble, self.siege.publish, self.siege.handle,
            self.siege.behave, self.siege.core, self.siege.core, self.declare, self.core_dies,
            self.restart_core, self.siege.restart_hostile,
        ]  # fmt: skip

    def word(self) -> int:
        """A small number, an edge case, or any word."""
        choice = self.bytes.ConsumeIntInRange(0, 31)
        if choice <= 12:
            return choice
        if choice - 13 < len(EDGES):
            return EDGES[choice - 13]
        return self.bytes.ConsumeUInt(8)

    def place(self) -> int:
        """A word of the segment: as often one of the few that steer as any of the many others."""
        choice = self.bytes.ConsumeIntInRange(0, 3)
        if choice <= 1:
            return self.bytes.PickValueInList(CONTROL_WORDS)
        if choice == 2:
            used = 4 * layout.DECLARATION_WORDS
            return layout.OUT_DECLARATIONS + self.bytes.ConsumeIntInRange(0, used - 1)
        return self.bytes.ConsumeIntInRange(0, layout.out_words(RING_RECORDS) - 1)

    def record(self) -> None:
        """Push a record of a kind that exists or not, that would do but for up to three of its words."""
        hostile = self.siege.hostile
        source = layout.pack_source(HOSTILE_SLOT, 0, hostile.incarnation)
        words = [self.bytes.PickValueInList(KINDS), self.siege.hostile_channel, source, 64, 8, 0, 1]
        for _ in range(self.bytes.ConsumeIntInRange(0, 3)):
            words[self.bytes.ConsumeIntInRange(0, 6)] = self.word()
        self.siege.record(*words)

    def scribble(self) -> None:
        """Write any word anywhere."""
        self.siege.scribble(self.place(), self.word())

    def declare(self) -> None:
        """Subscribe or advertise in due form; what that does to the hostile module is its own affair."""
        hostile, topic = self.siege.hostile, str(self.bytes.ConsumeIntInRange(0, 3))
        subscribes = self.bytes.ConsumeBool()
        handling = self.bytes.PickValueInList(list(MessageHandling))
        with contextlib.suppress(Exception):
            hostile.subscribe(handling, topic) if subscribes else hostile.advertise(topic, TYPE)

    def core_dies(self) -> None:
        """Let the core die in its next steps, with a word written over before the next one looks."""
        self.siege.core_dies(self.bytes.ConsumeIntInRange(0, 255), self.place(), self.word())

    def restart_core(self) -> None:
        """Let a new core take over from one at rest."""
        self.siege.run.fuse.deaths = []
        self.siege.run.restart_core()

    def run(self) -> None:
        """Take the steps; then demand what the siege demands, and that the books balance."""
        for _ in range(MAX_STEPS):
            if not self.bytes.remaining_bytes():
                break
            self.bytes.PickValueInList(self.steps)()
            self.siege.run.supervisor_notices()
        self.siege.end()
        check_books(self.siege)


def check_books(siege: Siege) -> None:
    """Demand that every message routed to anybody was delivered, replaced, dropped or lost.

    Raises:
        AssertionError: if one was not, or still waits although everything has been handled.
    """
    run = siege.run
    for number in range(run.tables.sizes.subscriptions):
        counts = run.counts(number)
        assert counts["routed"] == sum(counts.values()) - counts["routed"], f"subscription {number}: {counts}"
    for slot in range(run.tables.sizes.slots):
        assert run.waiting(slot) == 0, f"{run.waiting(slot)} messages of slot {slot} wait for nobody"


def fuzz(arguments: Sequence[str]) -> None:
    """Fuzz in this process, which libFuzzer ends."""
    atheris.Setup([sys.argv[0], *arguments], lambda data: Attack(data).run())
    atheris.Fuzz()


def campaign(seconds: int, seed: int, repeat: Path | None) -> int:
    """Fuzz in a process of its own; return how it ended: 0, or 1 if there was a finding."""
    with tempfile.TemporaryDirectory() as corpus:
        options = [
            f"-seed={seed}", f"-timeout={HANG_S}", f"-error_exitcode={FINDING_EXIT}",
            f"-artifact_prefix={os.getcwd()}/",
        ]  # fmt: skip
        if repeat:
            options.append(str(repeat))
        else:
            options += [f"-max_total_time={seconds}", f"-max_len={MAX_INPUT_BYTES}", "-len_control=0"]
            options += ["-print_final_stats=1", corpus]
        command = [sys.executable, "-m", "tools.fuzz_core", FUZZ_ONLY, *options]
        try:
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=seconds + START_AND_END_S, check=False
            )
        except subprocess.TimeoutExpired:
            print(f"finding: still running {START_AND_END_S:.0f} s after its time", file=sys.stderr)
            return FINDING_EXIT
    output = ended.stdout + ended.stderr
    print(summary(output, ended.returncode))
    if ended.returncode:
        print(output, file=sys.stderr)
    return FINDING_EXIT if ended.returncode else 0


def summary(output: str, returncode: int) -> str:
    """Say in one line what libFuzzer wrote in many."""

    def last(pattern: str) -> str:
        return (re.findall(pattern, output) or ["?"])[-1]

    return (
        f"{last(r'number_of_executed_units: *([0-9]+)')} executions, "
        f"coverage {last(r'cov: ([0-9]+)')} (features {last(r'ft: ([0-9]+)')}), "
        + (f"finding kept in {last(r'Test unit written to (.*)')}" if returncode else "no finding")
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] == [FUZZ_ONLY]:
        fuzz(given[1:])
        return 0
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz_core", description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=int, default=60, metavar="N")
    parser.add_argument("--seed", type=int, default=1, help="of the fuzzer; not 0, which is random")
    parser.add_argument("--input", type=Path, metavar="FILE", help="run the input of a finding again")
    options = parser.parse_args(given)
    return campaign(options.seconds, options.seed, options.input)


if __name__ == "__main__":
    sys.exit(main())
