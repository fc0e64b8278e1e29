"""Code that hangs, prints, forks or kills affects neither the check of a profile nor its caller."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from tests.run.profile.conftest import PLAIN, Robot

ASK = """
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.profile.preflight import preflight
from robbie_mp.base.problem import ProfileError
preflight(load_profile("demo"), timeout_s=0.5, base_class="base_of_modules:Base")
"""


def wait_until(condition: Callable[[], bool], limit_s: float = 20.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


@pytest.mark.slow
def test_hanging_import_is_abandoned_and_the_rest_is_checked(robot: Robot) -> None:
    robot.write_code("mods.slow", "import threading; threading.Event().wait()")
    robot.write("demo", f"modules: {{slow: {{class: 'mods.slow:A'}}, bad: {{class: 'no:A'}}, ok: {PLAIN}}}")
    with pytest.raises(
        Exception, match=r"^profiles/demo\.yaml:1: modules\.bad\.class: there is no Python module"
    ):
        robot.preflight(timeout_s=1.0)
    robot.write("demo", f"modules: {{slow: {{class: 'mods.slow:A'}}, ok: {PLAIN}}}")
    findings = robot.preflight(timeout_s=1.0)
    assert findings.failures == {"slow": "mods.slow: did not finish within 1 s while it was imported"}
    assert "ok" in findings.settings


def test_output_of_imported_code_disturbs_nothing(robot: Robot, capfd: pytest.CaptureFixture[str]) -> None:
    robot.write_code(
        "mods.noisy",
        """
        import os, sys
        from base_of_modules import Base
        print('{"broken": "by print"}', flush=True)
        os.write(1, b"to descriptor 1\\n")
        os.system("echo from a child")
        print("to stderr", file=sys.stderr)
        assert sys.stdin.read() == ""
        class Noisy(Base): pass
        """,
    )
    robot.write("demo", "modules: {a: {class: 'mods.noisy:Noisy'}}")
    findings = robot.preflight()
    assert (findings.settings, findings.failures) == ({"a": {}}, {})
    assert capfd.readouterr() == ("", "")


def test_threads_forks_and_children_of_imported_code_do_not_outlive_the_check(robot: Robot) -> None:
    robot.write_code(
        "mods.busy",
        """
        import os, subprocess, sys, threading
        from pathlib import Path
        from base_of_modules import Base
        threading.Thread(target=threading.Event().wait).start()
        child = subprocess.Popen(["sleep", "1000"])
        Path("child.pid").write_text(str(child.pid))
        os.fork()
        class Busy(Base): pass
        """,
    )
    robot.write("demo", f"modules: {{a: {{class: 'mods.busy:Busy'}}, b: {PLAIN}}}")
    findings = robot.preflight()
    assert (findings.settings, findings.failures) == ({"a": {}, "b": {}}, {})
    child = int(Path("child.pid").read_text())
    wait_until(lambda: not psutil.pid_exists(child) or psutil.Process(child).status() == psutil.STATUS_ZOMBIE)


def test_thread_that_kills_the_process_later_affects_no_other_module(robot: Robot) -> None:
    robot.write_code(
        "mods.bomb",
        """
        import os, sys, threading
        from base_of_modules import Base
        class Bomb(Base):
            @classmethod
            def check(cls, settings):
                threading.Thread(target=cls.wait_for_the_next).start()
            @staticmethod
            def wait_for_the_next():
                while "mods.next" not in sys.modules: pass
                os._exit(7)
        """,
    )
    robot.write_code("mods.next", "import time; time.sleep(60)")
    robot.write(
        "demo", f"modules: {{a: {{class: 'mods.bomb:Bomb'}}, n: {{class: 'mods.next:N'}}, b: {PLAIN}}}"
    )
    findings = robot.preflight()
    assert findings.settings.keys() == {"a", "b"}
    assert findings.failures == {"n": "mods.next: ended with exit code 7 while it was imported"}


def test_hanging_import_ends_when_its_parent_is_killed(robot: Robot) -> None:
    robot.write_code(
        "mods.slow",
        """
        import os, threading
        with open("pid.new", "w") as file: file.write(str(os.getpid()))
        os.rename("pid.new", "pid")
        threading.Event().wait()
        """,
    )
    robot.write("demo", "modules: {slow: {class: 'mods.slow:A'}}")
    asking = subprocess.Popen(
        [sys.executable, "-c", ASK], env=os.environ | {"PYTHONPATH": ":".join(sys.path)}
    )
    wait_until(Path("pid").exists)
    checking = psutil.Process(int(Path("pid").read_text()))
    asking.kill()
    asking.wait()
    wait_until(lambda: not checking.is_running() or checking.status() == psutil.STATUS_ZOMBIE)


def test_code_that_closes_the_result_pipe_is_distinguished_from_a_profile_error(robot: Robot) -> None:
    robot.write_code("mods.closer", "import os; os.closerange(3, 100)\nclass A: pass")
    robot.write("demo", f"modules: {{a: {{class: 'mods.closer:A'}}, b: {PLAIN}}}")
    findings = robot.preflight()
    assert "mods.closer: ended with exit code" in findings.failures["a"]
    assert findings.settings.keys() == {"b"}
