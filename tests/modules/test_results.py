"""Modules write the files of a run so that links there are not followed and others cannot read them."""

import re
from pathlib import Path

import pytest

from robbie_mp import Module, ModuleHarness
from robbie_mp.module.module import ResultNotWritten
from robbie_robots.modules.maps.mapping import Mapping

MODULES = Path(__file__).parents[2] / "modules"
RESULTS = ("map.png", "map.pgm", "map.yaml", "mapping.json", "trajectory.txt")
OTHER_WRITERS = re.compile(r"""write_text|write_bytes|savetxt\(self|open\([^)]*["'][wax]""")


def test_results_of_mapping_replace_planted_links_and_files(tmp_path: Path) -> None:
    victim, folder = tmp_path / "victim", tmp_path / "results"
    victim.write_text("precious")
    folder.mkdir()
    for name in RESULTS[:3]:
        (folder / name).symlink_to(victim)
    for name in RESULTS[3:]:
        (folder / name).touch(mode=0o644)
    with ModuleHarness(Mapping, output_directory=folder):
        pass
    assert victim.read_text() == "precious"
    assert {path.name: path.lstat().st_mode for path in folder.iterdir()} == dict.fromkeys(RESULTS, 0o100600)


def test_result_that_cannot_be_written_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "result.json").mkdir()
    with (
        ModuleHarness(Module, output_directory=tmp_path) as harness,
        pytest.raises(ResultNotWritten, match=r"result\.json: Is a directory"),
    ):
        harness.module.write_result("result.json", "{}")


def test_no_module_writes_files_in_another_way() -> None:
    found = [
        f"{path.relative_to(MODULES)}: {line.strip()}"
        for path in MODULES.rglob("*.py")
        for line in path.read_text().splitlines()
        if OTHER_WRITERS.search(line)
    ]
    assert found == []
