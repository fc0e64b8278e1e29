"""What all trials share: the command line, one case after the other, and the report."""

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Case:
    """What is played now.

    Attributes:
        seed: of everything that is random.
        kind: one of the subject's kinds; "" if it has none.
        folder: an empty folder for the case's files.
        options: of the command line.
        prepared: what the subject has prepared for all cases.
    """

    seed: int
    kind: str
    folder: Path
    options: argparse.Namespace
    prepared: Any = None


def no_options(parser: argparse.ArgumentParser) -> None:
    """Add no options."""


@dataclass(frozen=True, kw_only=True)
class TrialSubject(Generic[Result]):
    """What is tried.

    Attributes:
        play: plays a case; the result is a dataclass or a dictionary.
        summary: returns the figures of all results together; none if there is only one.
        is_good: whether the results are as they should be; the exit code.
        results: what the results are called in the report, such as "missions".
        seeds: number of seeds if the command line names none.
        seed_makes: what each seed makes, such as "an arena".
        options: adds the options of its own.
        kinds: what is played for each seed, one after the other.
        prepare: makes what all cases share.
    """

    play: Callable[[Case], Result]
    summary: Callable[[list[Result]], dict[str, Any]] = lambda _: {}
    is_good: Callable[[list[Result]], bool] = lambda _: True
    results: str = "results"
    seeds: int = 20
    seed_makes: str
    options: Callable[[argparse.ArgumentParser], None] = no_options
    kinds: Callable[[argparse.Namespace], Sequence[str]] = lambda _: ("",)
    prepare: Callable[[argparse.Namespace], Any] = lambda _: None


class CannotTry(ValueError):
    """A trial that cannot begin, such as one whose data are missing; the text says what to do.

    Example scenarios:
        - `python -m tools.trials kidnap` without the Intel log
        - `python -m tools.trials household --tasks dance`
    """


def names_of(chosen: Sequence[str], known: Collection[str]) -> list[str]:
    """Return the chosen names, or all if none is chosen.

    Raises:
        CannotTry: one of them is not known.
    """
    if unknown := [name for name in chosen if name not in known]:
        raise CannotTry(f"there is no {unknown[0]!r}; there are {'; '.join(known)}")
    return list(chosen or known)


def command_line(subject: TrialSubject[Any], name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options of all trials, and the subject's own."""
    parser = argparse.ArgumentParser(
        prog=f"python -m tools.trials {name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    seeds = f"number of seeds; each makes {subject.seed_makes} ({subject.seeds})"
    parser.add_argument("--seeds", type=int, default=subject.seeds, metavar="N", help=seeds)
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first seed (0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="new folder for the files of all cases")
    subject.options(parser)
    return parser


def run(subject: TrialSubject[Result], name: str, description: str | None, words: Sequence[str]) -> int:
    """Run a subject's command line.

    Returns:
        The exit code: 0 if all is as it should be, 1 if it is not, 2 if the trial cannot begin.
    """
    parser = command_line(subject, name, description)
    options = parser.parse_args(words)
    try:
        with _folder(options.keep) as folder:
            results = play_all(subject, options, folder)
    except CannotTry as error:
        parser.error(str(error))
    return int(not subject.is_good(results))


def play_all(subject: TrialSubject[Result], options: argparse.Namespace, folder: Path) -> list[Result]:
    """Play all cases, print each result and the summary, and write them to the file of `--json`."""
    results: list[Result] = []
    for case in cases(subject, options, folder):
        results.append(subject.play(case))
        print(json.dumps(_plain(results[-1])), flush=True)
        if options.json:  # after each case, so that a trial that is ended has figures, too
            report = {"summary": subject.summary(results), subject.results: [_plain(one) for one in results]}
            options.json.write_text(json.dumps(report, indent=2) + "\n")
    if summary := subject.summary(results):
        print(json.dumps(summary, indent=2, ensure_ascii=False))
    return results


def cases(subject: TrialSubject[Any], options: argparse.Namespace, folder: Path) -> Iterator[Case]:
    """Yield the cases, each with a new folder of its own: for each seed one of each kind."""
    prepared = subject.prepare(options)
    for seed in range(options.first, options.first + options.seeds):
        for kind in subject.kinds(options):
            own = folder / (f"{seed}-{kind}" if kind else str(seed))
            own.mkdir(parents=True)
            yield Case(seed, kind, own, options, prepared)


def _plain(result: Any) -> dict[str, Any]:
    return dict(result) if isinstance(result, dict) else asdict(result)


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        yield keep
        return
    folder = Path(tempfile.mkdtemp(prefix="robbie-trials-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
