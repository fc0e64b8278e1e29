"""Large maps are read and described in little more memory than their cells take."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robbie_robots.workers.maps.map_file import write_large_map, write_map

pytestmark = pytest.mark.slow

PEAK = """
import resource, sys
from pathlib import Path
from PIL import PngImagePlugin
from robbie_robots.workers.maps import map_file

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

before = peak()
read = getattr(map_file, sys.argv[1])(Path(sys.argv[2]))
print(peak() - before)
"""


def peak_bytes(function: str, path: Path) -> int:
    """Return by how much a function raises the peak of a fresh process's memory, Pillow's included."""
    command = [sys.executable, "-c", PEAK, function, str(path)]
    return int(subprocess.run(command, capture_output=True, check=True, timeout=300).stdout)


def test_own_map_of_14000_by_14000_cells_is_read_back(tmp_path: Path) -> None:
    edge = 14_000
    band = np.tile(np.array([0, 100, -1, 0], np.int8), (edge // 100, edge // 4))
    write_large_map(
        tmp_path / "map.yaml", (edge, edge), [band] * 100, 0.05, (0, 0), lambda file: file.open("wb")
    )
    assert peak_bytes("read_map", tmp_path / "map.yaml") < 1.2 * edge**2
    assert peak_bytes("describe_map", tmp_path / "map.yaml") < 0.2 * edge**2


@pytest.mark.parametrize(("mode", "depth"), [("L", 8), ("RGBA", 8), ("I;16", 16), ("P", 8), ("1", 1)])
def test_every_kind_of_png_is_read_in_bands(tmp_path: Path, mode: str, depth: int) -> None:
    edge = 5_000
    shades = np.tile(np.arange(edge) // 20, (edge, 1)).astype(np.uint16 if depth == 16 else np.uint8)
    image = Image.fromarray(shades * 257 if depth == 16 else shades)
    (image if depth == 16 else image.convert(mode)).save(tmp_path / "map.png", compress_level=1)
    write_map(tmp_path / "map.yaml", np.zeros((1, 1), np.int8), 0.05, (0, 0))
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace("map.pgm", "map.png"))
    assert peak_bytes("read_map", tmp_path / "map.yaml") < 2 * edge**2
