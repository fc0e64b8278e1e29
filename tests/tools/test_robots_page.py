"""The page about the robots agrees with their profiles and their code."""

import pytest

from tools.docs.robots_page import PAGE, figures, own_files, page, robots

AGAIN = "write it again with `python -m tools.docs.robots_page`"


@pytest.fixture(scope="module")
def now() -> str:
    return page()


def test_page_names_the_modules_of_the_profiles(now: str) -> None:
    assert PAGE.read_text().partition("## Code")[0] == now.partition("## Code")[0], AGAIN


def test_figures_of_the_page_are_those_of_the_code(now: str) -> None:
    on_page = figures(PAGE.read_text())
    assert on_page.keys() == figures(now).keys()
    for name, counted in figures(now).items():
        # A tenth: not every change of a file needs a new page.
        assert on_page[name] == pytest.approx(counted, rel=0.1, abs=50), AGAIN


def test_own_code_is_what_no_other_robot_imports() -> None:
    found = {robot.name: robot for robot in robots()}
    numbers = own_files(found["numbers"], list(found.values()))
    assert "workers/numbers/mission.py" in numbers
    assert "workers/mapping/grid_mapper.py" in found["numbers"].files
    assert "workers/mapping/grid_mapper.py" not in numbers
    total, shared, own = figures(page())["numbers"][1:]
    assert total == shared + own
