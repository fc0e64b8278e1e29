"""Starts a real Chromium without a window, controlled by Playwright."""

import shlex
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
"""The first is Chromium without its windows, which needs a third less processor time."""
CHROMIUM = next(filter(None, map(shutil.which, PROGRAMS)), None)
ARGUMENTS = [
    "--no-sandbox",  # tests may run as root, and Chromium's sandbox does not
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
]


@contextmanager
def chromium(program: str | Path | None = CHROMIUM) -> Iterator[Browser]:
    """Start a browser. At the end, end it and all its processes.

    Args:
        program: path of Chromium, or of a program that starts it.
    """
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
        yield started
        started.close()


@contextmanager
def chromium_by(command: Sequence[str], folder: Path, *arguments: str) -> Iterator[Browser]:
    """Start a browser by another command, such as one that runs it on another host. At the end, end it.

    Args:
        command: the beginning of the command.
        folder: where a script that starts it is written.
        arguments: more arguments of the browser.
    """
    starter = folder / "chromium"
    starter.write_text(f'#!/bin/sh\nexec {shlex.join([*command, str(CHROMIUM), *arguments])} "$@"\n')
    starter.chmod(0o755)
    with chromium(starter) as started:
        yield started
