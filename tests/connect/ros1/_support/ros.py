"""ROS 1 on this machine, as Debian installs it."""

import subprocess
from pathlib import Path

import pytest

SYSTEM_PYTHON = "/usr/bin/python3"
"""The interpreter that has rospy."""

needs_ros1 = pytest.mark.skipif(
    not Path("/usr/bin/roscore").exists(),
    reason="ROS 1 is not installed here; docs/ros1.md has the command that installs it",
)


def system_python(program: str, text: str = "") -> str:
    """Run a program beside ROS, and return what it prints."""
    done = subprocess.run(
        [SYSTEM_PYTHON, "-c", program], input=text, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
