"""A program that was started without standard streams does not write its errors into its own files."""

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from robbie_mp.cli import main
main(["list"])
with open(sys.argv[1], "w") as file:
    file.write(str(file.fileno()))
"""


@pytest.mark.parametrize("closed", [(0,), (2,), (0, 1, 2)])
def test_no_file_gets_the_number_of_a_standard_stream_that_is_closed(
    tmp_path: Path, closed: tuple[int, ...]
) -> None:
    """The supervisor had its board in the place of standard error."""
    closing = " ".join(f"{number}>&-" for number in closed)
    made = tmp_path / "made"
    command = ["sh", "-c", f'exec "$@" {closing}', "sh", sys.executable, "-c", PROGRAM, str(made)]
    subprocess.run(command, check=True, timeout=60, stdout=subprocess.DEVNULL)
    assert int(made.read_text()) > 2
