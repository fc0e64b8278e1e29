"""A short kill campaign, and a proof that its verdict can fail."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.bus.observe import ChannelFigures, ModuleFigures, SubscriptionFigures
from tools.kill_campaign import frozen_log, neighbours
from tools.kill_campaign.__main__ import main
from tools.kill_campaign.calls import judge_calls
from tools.kill_campaign.campaign import _other_ends
from tools.kill_campaign.latched import BEAT, COMERS, LATCHED, VISITOR, judge_latched
from tools.kill_campaign.message import Numbered
from tools.kill_campaign.neighbours import Rates, ratio_of
from tools.kill_campaign.verdict import judge, read_records

NAMES = ["talker", "hearer"]
TALK = """
S 1 5 .
I 0 10 .
A 0 11 .
I 1 12 .
R 1 13 .
I 2 14 .
A 2 15 .
I 3 16 .

S 2 20 .
I 0 21 .
A 0 22 .
I 1 23 .
A 1 24 .
"""
HEAR = """
S 1 4 .
E 7 talker 1 0 1 10 12 .
L 7 1 13 .
E 8 talker 1 2 1 14 16 .

S 2 18 .
E 10 talker 2 0 1 21 23 .
L 10 1 24 .
E 11 talker 2 1 1 23 25 .
L 11 1 26 .
"""
BOOKS = SubscriptionFigures(
    5,
    delivered=3,
    replaced=0,
    dropped=1,
    lost=1,
    type_name=Numbered.type_name,
    topic="talker",
    handling="ALWAYS_DELIVER",
)


def violations(
    folder: Path,
    talk: str = TALK,
    hear: str = HEAR,
    books: SubscriptionFigures = BOOKS,
    *,
    restarts: int = 1,
    messages: int = 5,
    refused: int = 1,
) -> list[str]:
    (folder / "talker.journal").write_text(talk)
    (folder / "hearer.journal").write_text(hear)
    modules = {
        "talker": figures("talker", restarts=1, published=5, refused=refused),
        "hearer": figures("hearer", restarts=restarts, subscriptions=(books,)),
    }
    channels = [ChannelFigures(messages, 1000, type_name=Numbered.type_name, version=1, topic="talker")]
    return judge(read_records(folder, NAMES), modules, channels).violations


def figures(name: str, **known: object) -> ModuleFigures:
    types = {field.name: field.type for field in dataclasses.fields(ModuleFigures)}
    values = {
        field: "" if kind is str else () if field == "subscriptions" else 0 for field, kind in types.items()
    }
    return ModuleFigures(**{**values, "name": name, **known})  # type: ignore[arg-type]


def without(text: str, line: str) -> str:
    assert line in text
    return text.replace(line + "\n", "")


def test_journals_that_agree_with_the_counters_are_not_a_violation(tmp_path: Path) -> None:
    assert violations(tmp_path) == []


def test_uncertain_message_may_be_unpublished(tmp_path: Path) -> None:
    books = dataclasses.replace(BOOKS, routed=4, dropped=0)
    assert violations(tmp_path, books=books, messages=4) == []
    books = dataclasses.replace(BOOKS, routed=3, dropped=0, delivered=2)
    assert violations(tmp_path, books=books, messages=3)


def test_uncertain_message_that_a_subscriber_has_was_published(tmp_path: Path) -> None:
    hear = HEAR.replace("\nS 2 18 .", "E 9 talker 1 3 1 16 17 .\n\nS 2 18 .").replace(
        "E 8 talker 1 2 1 14 16 .", "E 8 talker 1 2 1 14 16 .\nL 8 1 17 ."
    )
    books = dataclasses.replace(BOOKS, delivered=4, dropped=0)
    assert violations(tmp_path, hear=hear, books=books) == []
    assert violations(
        tmp_path, hear=hear, books=dataclasses.replace(books, routed=4, delivered=3), messages=4
    )


@pytest.mark.parametrize(
    ("line", "tampered"),
    [
        ("E 10 talker 2 0 1 21 23 .", "E 8 talker 2 0 1 21 23 ."),  # the same sequence again
        ("E 10 talker 2 0 1 21 23 .", "E 10 talker 1 2 1 21 23 ."),  # the same message again
        ("E 10 talker 2 0 1 21 23 .", "E 6 talker 2 0 1 21 23 ."),  # out of order
        ("E 10 talker 2 0 1 21 23 .", "E 10 talker 2 0 0 21 23 ."),  # wrong checksum
        ("E 10 talker 2 0 1 21 23 .", "E 10 talker 1 1 1 21 23 ."),  # was refused
        ("E 10 talker 2 0 1 21 23 .", "E 10 talker 1 9 1 21 23 ."),  # was never published
        ("L 10 1 24 .", "L 10 0 24 ."),  # changed in the handler's hands
        ("S 2 18 .", "S 1 18 ."),  # a checkpoint was forgotten
    ],
)
def test_tampered_journal_is_a_violation(tmp_path: Path, line: str, tampered: str) -> None:
    assert line in HEAR
    assert violations(tmp_path, hear=HEAR.replace(line, tampered))


def test_message_that_was_delivered_but_never_handled_is_a_violation(tmp_path: Path) -> None:
    hear = without(without(HEAR, "E 11 talker 2 1 1 23 25 ."), "L 11 1 26 .")
    assert violations(tmp_path, hear=hear)


@pytest.mark.parametrize(
    "change", [{"routed": 6}, {"routed": 4}, {"delivered": 4}, {"dropped": 0}, {"lost": 0}]
)
def test_counter_that_is_off_by_one_is_a_violation(tmp_path: Path, change: dict[str, Any]) -> None:
    assert violations(tmp_path, books=dataclasses.replace(BOOKS, **change))


def test_last_message_that_has_not_arrived_is_a_violation(tmp_path: Path) -> None:
    hear = without(without(HEAR, "E 11 talker 2 1 1 23 25 ."), "L 11 1 26 .")
    books = dataclasses.replace(BOOKS, delivered=2, dropped=2)
    assert violations(tmp_path, hear=hear, books=books) == [
        "hearer: the last message of talker, (2, 1), has not arrived"
    ]


def test_more_messages_lost_than_deaths_is_a_violation(tmp_path: Path) -> None:
    assert violations(tmp_path, restarts=0)


def test_channel_that_disagrees_with_its_publisher_is_a_violation(tmp_path: Path) -> None:
    books = dataclasses.replace(BOOKS, routed=6, dropped=2)
    assert violations(tmp_path, books=books, messages=6)


def test_uncounted_refusal_is_a_violation(tmp_path: Path) -> None:
    assert violations(tmp_path, refused=0)


def test_line_cut_short_by_a_kill_counts_as_never_written(tmp_path: Path) -> None:
    cut = TALK.replace("I 3 16 .\n", "I 3 16 .\nA 3 1\n")
    assert violations(tmp_path, talk=cut) == []


@pytest.mark.every_turn
@pytest.mark.alone
@pytest.mark.timeout(180)
def test_short_campaign_finds_no_violation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # This seed kills the core, and seven times a subscriber of latched topics.
    monkeypatch.setattr(frozen_log, "MEAN_PAUSE_S", 0.5)
    arguments = ["--kills", "12", "--seed", "129", "--longest-stop", "1", "--mean-pause", "0.8", "--json"]
    arguments += ["--camera-rounds", "1", "--freeze-log"]
    code = main([*arguments, "--keep", str(tmp_path)])
    report = json.loads(capsys.readouterr().out)
    assert code == 0, report["violations"]
    assert report["kills"] >= 12
    assert report["messages"]["handlers_entered"] > 1000
    assert report["restarts"]["core"] > 0
    assert report["calls"]["reply"] > 50
    assert report["calls"]["goal reached"] > 2
    assert report["latched"]["had the newest or a newer one"] > 0
    assert report["latched"]["visits of a tool"] > 1
    assert report["neighbours"]["stopped_viewer_dropped"] > 0
    assert report["neighbours"]["hoarder_copied"] > 0
    if not report["log_disk"]:
        pytest.skip("A FROZEN LOG DISK IS NOT TESTED: this machine does not allow one")
    assert report["log_disk"]["standstills"] >= 1
    assert report["log_disk"]["kills_while_frozen"] >= 1
    assert report["log_disk"]["restarts_while_frozen"] >= 1


def test_unexpected_restarts_are_reported_with_their_reason() -> None:
    said = "a: BACKOFF (killed by SIGKILL, again in 0.01 s)\n[a] INFO x\n"
    said += "b: BACKOFF (hung in handler of T for 5.0 s: killed by SIGABRT, again in 0.10 s)\n" * 2
    assert _other_ends(said) == {"b: hung in handler of T for 5.0 s: killed by SIGABRT": 2}


def test_viewer_slowed_down_by_others_is_a_violation() -> None:
    calm = Rates(viewed_hz=30.0, taken_hz=30.0)
    slowed = ratio_of(calm, Rates(viewed_hz=20.0, taken_hz=30.0))
    assert neighbours.violations({"ratios": [1.0, slowed, slowed]})
    assert not neighbours.violations({"ratios": [1.0, slowed, ratio_of(calm, Rates(28.0, 30.0))]})
    assert ratio_of(calm, Rates(0.0, 0.0)) == ratio_of(Rates(0.0, 30.0), calm) == 0.0


CALLER = """
S 1 5 .
C 1 6 .
C 2 7 .
D 1 reply 8 .

S 2 20 .
C 1 21 .
D 1 ServerDied 22 .
"""
CALLEE = """
S 0 1 .
H caller 4294967297 1 7 .
H caller 8589934593 1 21 .
"""


def call_violations(folder: Path, caller: str = CALLER, callee: str = CALLEE) -> list[str]:
    (folder / "caller.journal").write_text(caller)
    (folder / "callee.journal").write_text(callee)
    return judge_calls(folder)[1]


def test_calls_that_end_once_are_not_a_violation(tmp_path: Path) -> None:
    assert call_violations(tmp_path) == []
    assert judge_calls(tmp_path)[0] == {
        "reply": 1, "ServerDied": 1, "cut off by the death of the client": 1, "handled": 2, "goals resumed": 0
    }  # fmt: skip


@pytest.mark.parametrize(
    ("caller", "callee"),
    [
        (CALLER.replace("D 1 reply 8 .", "D 1 reply 8 .\nD 1 reply 9 ."), CALLEE),  # two ends
        (CALLER.replace("D 1 ServerDied 22 .\n", ""), CALLEE),  # no end
        (CALLER.replace("D 1 ServerDied 22 .", "D 2 ServerDied 22 ."), CALLEE),  # that of a dead process
        (CALLER.replace("reply", "wrong"), CALLEE),
        (CALLER.replace("ServerDied", "NoServer"), CALLEE),
        (CALLER, CALLEE + "H caller 4294967297 1 30 .\n"),  # handled twice
        (CALLER.replace("D 1 reply 8 .", "D 1 reply 8 .\nF 1 9 ."), CALLEE),  # feedback after the end
    ],
)
def test_call_that_ends_twice_or_never_is_a_violation(tmp_path: Path, caller: str, callee: str) -> None:
    assert call_violations(tmp_path, caller, callee)


PAINTERS = {
    "painter": "S 1 1 .\nI 0 10 .\nA 0 11 .\nI 1 20 .\nR 1 21 .\nI 2 30 .\nA 2 31 .\n",
    "painter_rare": "S 1 1 .\nI 0 12 .\nA 0 13 .\n",
    BEAT: "S 1 1 .\nI 0 14 .\nA 0 14 .\nI 1 32 .\nA 1 32 .\nI 2 50 .\nA 2 50 .\n",
}
FIRST_LIFE = """S 1 2 .
E 1 painter 1 0 12 .
E 2 painter_rare 1 0 14 .
E 3 painter_beat 1 0 15 .
E 4 painter 1 2 33 .
E 5 painter_beat 1 1 34 .
"""
LATE_LIFE = """
S 2 40 .
E 2 painter_rare 1 0 44 .
E 4 painter 1 2 45 .
E 6 painter_beat 1 2 52 .
"""


def latched_violations(
    folder: Path, late: str = LATE_LIFE, name: str = "comer", **painters: str
) -> list[str]:
    """Judge a robot in which one subscriber starts late."""
    for publisher, journal in (PAINTERS | painters).items():
        (folder / f"{publisher}.journal").write_text(journal)
    for comer in (*COMERS, VISITOR):
        (folder / f"{comer}.journal").write_text(FIRST_LIFE + late * (comer == name))
    return judge_latched(folder)[1]


@pytest.mark.parametrize("name", [*COMERS, VISITOR])
def test_late_subscriber_that_has_the_newest_latched_messages_is_not_a_violation(
    tmp_path: Path, name: str
) -> None:
    assert latched_violations(tmp_path, name=name) == []
    assert judge_latched(tmp_path)[0] == {
        "given again": 2, "late joins": 2, "had the newest or a newer one": 2, "latched messages": 4,
        "visits of a tool": 1 + (name == VISITOR),
    }  # fmt: skip


def test_newer_message_may_take_the_place_of_the_newest(tmp_path: Path) -> None:
    newer = PAINTERS["painter"] + "I 3 41 .\nA 3 41 .\n"
    late = LATE_LIFE.replace("E 4 painter 1 2 45 .", "E 5 painter 1 3 45 .")
    others = {comer: f"{comer}: at rest" for comer in (*COMERS, VISITOR) if comer != "comer"}
    found = latched_violations(tmp_path, late, painter=newer)
    assert len(found) == len(others), "only those that have not got it are accused"
    assert not any(text.startswith("comer 2") for text in found)


@pytest.mark.parametrize(
    ("line", "tampered"),
    [
        ("E 4 painter 1 2 45 .\n", ""),  # none at all
        ("E 2 painter_rare 1 0 44 .\n", ""),
        ("E 4 painter 1 2 45 .", "E 1 painter 1 0 45 ."),  # an older one
        ("E 4 painter 1 2 45 .", "E 4 painter 1 1 45 ."),  # one that was refused
        ("E 4 painter 1 2 45 .", "E 4 painter 1 -1 45 ."),  # damaged
        ("E 4 painter 1 2 45 .", "E 4 painter 1 2 45 .\nE 4 painter 1 2 46 ."),  # twice
        (
            "E 4 painter 1 2 45 .\nE 6 painter_beat 1 2 52 .",
            "E 6 painter_beat 1 2 52 .\nE 4 painter 1 2 53 .",
        ),
        ("E 4 painter 1 2 45 .", "E 1 painter 1 0 45 .\nE 4 painter 1 2 45 ."),  # two from before
        ("E 6 painter_beat 1 2 52 .", "E 5 painter_beat 1 1 52 ."),  # given though it is not latched
    ],
)
@pytest.mark.parametrize("name", ["comer", "comer_newest", VISITOR])
def test_late_subscriber_without_the_newest_latched_message_is_a_violation(
    tmp_path: Path, name: str, line: str, tampered: str
) -> None:
    assert line in LATE_LIFE
    assert latched_violations(tmp_path, LATE_LIFE.replace(line, tampered), name)


def test_subscriber_that_lacks_the_last_latched_message_at_rest_is_a_violation(tmp_path: Path) -> None:
    last = {name: PAINTERS[name] + "I 7 60 .\nA 7 61 .\n" for name in LATCHED}
    assert len(latched_violations(tmp_path, **last)) == len([*COMERS, VISITOR]) * len(LATCHED)
