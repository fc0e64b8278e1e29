"""`robbie doctor [PROFILE]`: check whether robots can run on this machine."""

import argparse
import json
from collections import Counter
from dataclasses import asdict

from rich.text import Text

from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.run.doctor.examination import examine, worst
from robbie_mp.run.doctor.finding import Finding, Level
from robbie_mp.run.profile.load import load_profile

STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "bold red"}


def add_parser(subparsers: Commands) -> None:
    """Add `doctor` to the commands."""
    parser = add_command(
        subparsers,
        "doctor",
        "check whether robots can run on this machine",
        "Check kernel, Python, shared memory, limits, processors, clocks, permissions and the remains of "
        "dead runs. With a profile, check what it needs, and import its modules. Nothing is changed. Exit "
        "code 0: a robot can run here, perhaps with warnings; 1: it cannot.",
        ["robbie doctor", "robbie doctor robot"],
    )
    parser.add_argument("profile", nargs="?", help="name of a profile in profiles/, or path of a file")
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=doctor)


def doctor(arguments: argparse.Namespace) -> int:
    """Examine this machine, and print the findings."""
    profile = load_profile(arguments.profile) if arguments.profile else None
    findings = examine(profile)
    level = worst(findings)
    if arguments.json:
        print(json.dumps({"level": level, "findings": [asdict(finding) for finding in findings]}, indent=2))
    else:
        _print(findings)
    return int(level is Level.FAIL)


def _print(findings: list[Finding]) -> None:
    out = console()
    for finding in findings:
        level = Text(f"{finding.level:4}", STYLES[finding.level])
        out.print(Text.assemble(level, f"  {finding.check}: {finding.found}"), soft_wrap=True)
        if finding.advice:
            out.print(Text(f"      → {finding.advice}"), soft_wrap=True)
    counts = Counter(finding.level for finding in findings)
    out.print(", ".join(f"{counts[level]} {level}" for level in Level))
