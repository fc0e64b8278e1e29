"""A temporary robot workspace, current while a test runs, so that places read as in an error text."""

from pathlib import Path
from textwrap import dedent

import pytest

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.preflight import Preflight, preflight

BASE_CLASS = "base_of_modules:Base"


class Robot:
    """A workspace with profiles and code."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "profiles").mkdir()
        self.write_code("base_of_modules", "class Base: pass\nclass Plain(Base): pass")

    def write(self, name: str, text: str) -> None:
        """Write a profile."""
        file = self.root / "profiles" / f"{name}.yaml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(dedent(text))

    def write_code(self, module: str, text: str) -> None:
        """Write a Python module, with the packages around it."""
        file = self.root.joinpath(*module.split(".")).with_suffix(".py")
        for package in list(file.relative_to(self.root).parents)[:-1]:
            (self.root / package).mkdir(exist_ok=True)
            (self.root / package / "__init__.py").touch()
        file.write_text(dedent(text))

    def load(self, name: str = "demo", *overrides: str) -> Profile:
        """Load a profile."""
        return load_profile(name, overrides=overrides)

    def problems(self, name: str = "demo", *overrides: str) -> list[str]:
        """Load a profile that is wrong; return one text for each problem."""
        with pytest.raises(ProfileError) as caught:
            self.load(name, *overrides)
        return [str(problem) for problem in caught.value.problems]

    def preflight(self, *overrides: str, timeout_s: float = 30.0) -> Preflight:
        """Check the classes of the profile `demo`."""
        return preflight(self.load("demo", *overrides), timeout_s=timeout_s, base_class=BASE_CLASS)

    def preflight_problems(self, *overrides: str) -> list[str]:
        """Check the classes of a wrong profile `demo`; return one text for each problem."""
        with pytest.raises(ProfileError) as caught:
            self.preflight(*overrides)
        return [str(problem) for problem in caught.value.problems]


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Robot:
    monkeypatch.chdir(tmp_path)
    return Robot(tmp_path)


PLAIN = "{class: 'base_of_modules:Plain'}"


def write_class(robot: Robot, class_path: str) -> None:
    robot.write("demo", f"modules:\n  a:\n    class: {class_path}\n")
