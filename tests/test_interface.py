"""The author's interface: one import, without imports that would delay a restart of the core."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import robbie_mp


@pytest.mark.parametrize("name", robbie_mp.__all__)
def test_every_name_of_the_interface_is_that_of_its_home_module(name: str) -> None:
    home = import_module(robbie_mp._HOME_OF[name])
    assert getattr(robbie_mp, name) is getattr(home, name)


def test_type_checkers_see_the_same_names_as_the_interpreter() -> None:
    tree = ast.parse(Path(robbie_mp.__file__).read_text())
    seen = {
        alias.asname
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("robbie_mp")
        for alias in node.names
    }
    assert seen == set(robbie_mp.__all__)


def test_importing_the_package_imports_neither_numpy_nor_a_submodule() -> None:
    code = "import sys, robbie_mp; assert not {'numpy', 'robbie_mp.module'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        robbie_mp.no_such_name  # noqa: B018
