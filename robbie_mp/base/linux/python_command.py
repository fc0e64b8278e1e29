"""The command that runs a module of ours in a process of its own."""

import sys

_RUN = "import runpy, sys; del sys.path[0]; runpy.run_module(sys.argv.pop(1), run_name='__main__')"
"""As Python's option -P, which is new in 3.11: no file of the current folder hides a library's module."""


def python_command(module: str) -> list[str]:
    """Return the command that runs a module, whatever the current folder contains."""
    return [sys.executable, "-c", _RUN, module]
