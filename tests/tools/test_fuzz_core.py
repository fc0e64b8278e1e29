"""The fuzzer finds checks that were removed from the core, and reports and keeps its findings."""

import inspect
import sys
import textwrap
from itertools import islice
from pathlib import Path
from random import Random

import pytest

from robbie_mp.bus.core.flow import MessageFlow
from robbie_mp.bus.core.members import Link
from robbie_mp.bus.core.router import Router
from tools.fuzz.core.__main__ import main
from tools.fuzz.core.corpus import mutate, seeds
from tools.fuzz.core.plain import Hang, finding, inputs
from tools.fuzz.core.steps import STEP_BYTES, Do, decode, encode, step

MAX_INPUTS = 1500
"""Maximum number of inputs until a defect is found."""
MOST_OF_WHAT_IS_SOUND = 300
PLANTED: dict[str, tuple[type, str, str, str]] = {
    "a message in another's name": (MessageFlow, "on_publish", "!= link.source", "== None"),
    "a message on a channel not advertised": (
        MessageFlow, "on_publish", "channel = link.channels.get(declaration)",
        "channel = link.channels.get(declaration) or next(iter(link.channels.values()))",
    ),
    "a message larger than any memory": (MessageFlow, "on_publish", "if size > ", "if False and size > "),
    "a message beyond any segment": (MessageFlow, "on_publish", "or offset > ", "or False and offset > "),
    "a release of what it does not have": (
        MessageFlow, "on_release", "elif not link.is_repeated():", "elif False:",
    ),
    "a release of an older message": (
        MessageFlow, "on_release",
        "(entry := ledger.reference(reference))[0] == record[2]",
        "(entry := ledger.reference(reference))",
    ),
    "done with an older message": (
        MessageFlow, "on_done", "or self._ledger.reference(reference)[0] != record[2]", "",
    ),
    "done twice": (MessageFlow, "on_done", "if link.is_repeated():", "if True:"),
    "a word that only the supervisor has": (Router, "_receive", "and link.slot == SUPERVISOR_SLOT", ""),
    "a record of no kind": (
        Router, "_receive", 'raise ProtocolViolation(f"record of unknown kind {kind}")', "pass",
    ),
    "a declaration beyond the table": (
        Link, "declaration", "number >= layout.DECLARATION_COUNT", "False",
    ),
    "a held message that its holder's death does not free": (
        Router, "_reclaim", "for reference in link.pinned:", "for reference in ():",
    ),
}  # fmt: skip


def plant(defect: str, patch: pytest.MonkeyPatch) -> None:
    """Remove a check from the core."""
    owner, name, old, new = PLANTED[defect]
    source = textwrap.dedent(inspect.getsource(getattr(owner, name)))
    assert source.count(old) == 1, f"{owner.__name__}.{name} reads otherwise now; plant this defect again"
    namespace = vars(sys.modules[owner.__module__])
    changed: dict[str, object] = {}
    exec(f"from __future__ import annotations\n{source.replace(old, new)}", namespace, changed)
    patch.setattr(owner, name, changed[name])


def first_finding(most: int) -> bytes | None:
    return next((data for data in islice(inputs(seed=5), most) if finding(data, limit_s=2.0)), None)


@pytest.mark.parametrize("defect", PLANTED)
def test_missing_check_is_found(defect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(defect, monkeypatch)
    assert first_finding(MAX_INPUTS), f"not found with {MAX_INPUTS} inputs"


def test_unchanged_core_withstands_every_input() -> None:
    assert first_finding(MOST_OF_WHAT_IS_SOUND) is None


def test_finding_is_kept_and_played_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        plant("a message on a channel not advertised", patch)
        assert main(["--plain", "--seconds", "60"]) == 1
        [kept] = tmp_path.iterdir()
        assert f"finding kept in {kept}" in capsys.readouterr().err
        assert main(["--input", str(kept)]) == 1
        assert "is WRONG, but its module was not faulted" in capsys.readouterr().err
    assert main(["--input", str(kept)]) == 0
    assert "no finding" in capsys.readouterr().out


def test_missing_atheris_is_reported_with_the_package_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    assert main([]) == 2
    assert capsys.readouterr().err == (
        "fuzz_core: atheris is not installed: pip install 'robbie-mp[fuzz]', or use --plain\n"
    )
    assert main(["--input", "no-such-file"]) == 2


def test_core_that_hangs_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Router, "run_round", lambda _router: 1)
    assert isinstance(finding(b"", limit_s=0.1), Hang)


def test_mutations_keep_the_form_and_any_bytes_are_valid_input() -> None:
    random, known = Random(1), seeds()
    for _ in range(100):
        data = mutate(random.choice(known), random, known)
        assert encode(*decode(data)) == data
    assert list(decode(random.randbytes(STEP_BYTES - 1))) == []
    assert next(decode(bytes([len(Do) + Do.PUBLISH]) + bytes(7))).what is Do.PUBLISH
    assert encode(step(Do.CORE)) == b"\x02" + b"\xff" * 7
