"""Another user of the machine, played by a child process that gives up being root."""

import os
import traceback
from collections.abc import Callable

import pytest

NOBODY = 65534

needs_root = pytest.mark.skipif(
    os.geteuid() != 0, reason="ATTACKS BY ANOTHER USER ARE NOT TESTED: to become one takes root"
)


def as_nobody(attack: Callable[[], object]) -> None:
    """Run an attack as another user, to its end; what it asserts must hold there."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setgroups([])
            os.setresgid(NOBODY, NOBODY, NOBODY)
            os.setresuid(NOBODY, NOBODY, NOBODY)
            attack()
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0, "the attack itself failed; its traceback is above"


def is_refused(attack: Callable[[], object]) -> bool:
    """Whether the system refuses something to the user that asks."""
    try:
        attack()
    except PermissionError:
        return True
    return False
