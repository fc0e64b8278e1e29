"""Expands xacro files with ROS's own program (https://github.com/ros/xacro), if it is installed."""

import resource
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

from robbie_mp.scene.xml_elements import MAX_BYTES, Element, refused

TIMEOUT_S = 20.0
MEMORY_BYTES = 4 << 30
XMLNS = "xmlns:"


def needs_xacro(root: Element) -> bool:
    """Return whether XML has macros, which only xacro understands."""
    names = {key.removeprefix(XMLNS) for key, value in root.attributes.items() if _is_of_xacro(key, value)}
    return any(_has_macro(element, names | {"xacro"}) for element in root.walk())


def _is_of_xacro(key: str, value: str) -> bool:
    return key.startswith(XMLNS) and "xacro" in value


def _has_macro(element: Element, prefixes: set[str]) -> bool:
    prefix, colon, _ = element.tag.partition(":")
    values = element.attributes.values()
    return bool(colon and prefix in prefixes) or any("${" in value or "$(" in value for value in values)


def expand(file: Path) -> bytes:
    """Return what xacro makes of a file.

    xacro evaluates the expressions in the file, and includes other files: expand only files that you trust.

    Raises:
        SceneFileError: xacro is not installed, fails, takes too long, or writes too much.
    """
    here = str(Path(sys.executable).parent)
    program = shutil.which("xacro") or shutil.which("xacro", path=here)
    if program is None:
        raise refused(
            "this file has xacro macros, and xacro is not installed: `pip install xacro` or source your ROS, "
            f"or expand it elsewhere with `xacro {file.name} > {file.stem}.urdf`",
            file,
        )
    with TemporaryFile() as output, TemporaryFile() as errors:
        command = [program, str(file.absolute())]
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=errors)
        _wait(process, file)
        output.seek(0)
        errors.seek(0)
        if process.returncode == 0:
            return output.read(MAX_BYTES)
        lines = errors.read(1 << 16).decode(errors="replace").strip().splitlines()
    reason = " ".join(lines[-2:])[:400] or f"it ended with {process.returncode}"
    raise refused(f"xacro refuses it: {reason}", file)


def _wait(process: "subprocess.Popen[bytes]", file: Path) -> None:
    try:
        # a loop in a macro could fill the disk or the memory
        with suppress(ProcessLookupError):
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (MAX_BYTES, MAX_BYTES))
            resource.prlimit(process.pid, resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        process.wait(TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise refused(f"xacro did not end within {TIMEOUT_S:g} s", file) from None
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
