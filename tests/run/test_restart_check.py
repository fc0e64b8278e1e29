"""`robbie module restart` checks the code first, so that a mistake does not stop a module that runs well."""

import pytest

from tests._support.robot import Robot

MODULES = """\
from robbie_mp import Module


class Ground(Module):
    pass
"""
ABOVE = MODULES.replace("Ground", "Above")
PROFILE = """
modules:
  ground: {class: "ground:Ground"}
  above: {class: "above:Above", depends_on: [ground]}
"""
MISTAKES = {
    "class Ground(Module)\n    pass": "ground.py:4: SyntaxError: expected ':' in `class Ground(Module)`",
    "import no_such_library": "modules.ground.class: ground:Ground cannot be imported: ModuleNotFoundError",
}


@pytest.mark.slow
def test_module_whose_code_is_wrong_is_not_restarted(robot: Robot) -> None:
    ground, above = robot.folder / "ground.py", robot.folder / "above.py"
    ground.write_text(MODULES)
    above.write_text(ABOVE)
    robot.write_profile(PROFILE)
    robot.start()
    before = robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))

    for code, said in MISTAKES.items():
        ground.write_text(MODULES.replace("class Ground(Module):\n    pass", code))
        answer = robot.command("module", "restart", "ground")
        assert (answer.returncode, answer.stdout) == (2, "")
        assert said in answer.stderr
    ground.write_text(MODULES)
    above.write_text("class Above(Modul): pass\n")
    answer = robot.command("module", "restart", "ground")
    assert answer.returncode == 2
    assert "above.py:1: NameError: name 'Modul' is not defined" in answer.stderr
    now = robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))
    assert all(one["pid"] == before[name]["pid"] for name, one in now.items())

    above.write_text(ABOVE)
    assert robot.command("module", "restart", "ground").stdout == "ground is RUNNING, start 2\n"


@pytest.mark.slow
def test_new_code_that_raises_is_said_with_its_line_at_the_first_start(robot: Robot) -> None:
    ground = robot.folder / "ground.py"
    ground.write_text(MODULES)
    robot.write_profile('modules: {ground: {class: "ground:Ground", restart: {max_restarts: 1000}}}')
    robot.start()
    robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))
    ground.write_text(
        MODULES.replace("    pass", "    def setup(self):\n        raise LookupError('no map')")
    )
    answer = robot.command("module", "restart", "ground")
    assert answer.returncode == 1
    assert "ground is BACKOFF: exit code 1" in answer.stderr
    assert "LookupError: no map (ground.py:6)" in answer.stderr
