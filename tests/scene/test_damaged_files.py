"""A damaged scene file is read, or refused with a SceneFileError that names a place in it."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.scene import SceneFileError, SceneGraph, read_scene
from tests.scene._support.strategies import PATIENT
from tests.scene.test_scene_file import ROBOT
from tests.scene.test_urdf import ARM

PATCHES = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 30), st.binary(max_size=8)), min_size=1, max_size=3
)


@pytest.mark.parametrize(("text", "name"), [(ROBOT, "scene.yaml"), (ARM, "arm.urdf")])
@given(patches=PATCHES)
@settings(PATIENT, max_examples=60)
def test_damaged_files_are_read_or_refused(
    tmp_path: Path, text: str, name: str, patches: list[tuple[float, int, bytes]]
) -> None:
    data = text.encode()
    for where, removed, put in patches:
        at = int(where * len(data))
        data = data[:at] + put + data[at + removed :]
    file = tmp_path / name
    file.write_bytes(data)
    try:
        SceneGraph(read_scene(file))
    except SceneFileError as error:
        assert all(str(problem).startswith(f"{file}:") for problem in error.problems)
