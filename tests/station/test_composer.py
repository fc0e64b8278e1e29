"""Forms for message types: valid input is sent, and errors are reported at their fields."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.messages import DriveCommand, LaserScan, PoseStamped
from robbie_mp.station.panels.composer import FormError, compose, form_of

PATHS = [field.path for field in form_of(PoseStamped)]


def test_form_has_a_line_for_each_field_including_nested_messages() -> None:
    fields = {field.path: (str(field.kind), field.default) for field in form_of(PoseStamped)}
    assert list(fields)[:3] == ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    assert fields["pose.position.x"] == ("float64", "0.0")
    assert fields["pose.orientation.w"] == ("float64", "1.0")
    assert fields["header.frame_id"] == ("string", "")


def test_empty_form_is_the_default_message() -> None:
    assert compose(PoseStamped, dict.fromkeys(PATHS, " ")) == PoseStamped()
    assert compose(LaserScan, {}) == LaserScan()


def test_texts_are_converted_to_fields() -> None:
    scan = compose(
        LaserScan, {"header.frame_id": "front: left", "ranges": "[1, 2.5, .inf]", "angle_min": "-1e-1"}
    )
    assert isinstance(scan, LaserScan)
    ranges = np.array([1, 2.5, np.inf], np.float32)
    assert scan == LaserScan(header=scan.header, ranges=ranges, angle_min=-0.1)
    assert scan.header.frame_id == "front: left"


def test_each_error_belongs_to_its_field() -> None:
    texts = {
        "linear_m_per_s": "fast",
        "angular_rad_per_s": "[1",
        "valid_for.sec": "99999999999",
        "header.frame_id": "base_link",
    }
    with pytest.raises(FormError) as refused:
        compose(DriveCommand, texts)
    assert sorted(refused.value.problems) == ["angular_rad_per_s", "linear_m_per_s", "valid_for.sec"]
    assert "linear_m_per_s" in refused.value.problems["linear_m_per_s"]


@settings(max_examples=40, deadline=None)
@given(st.dictionaries(st.sampled_from(PATHS), st.text(max_size=12)))
def test_any_input_is_a_message_or_an_error_of_a_field(texts: dict[str, str]) -> None:
    try:
        compose(PoseStamped, texts).encode()
    except FormError as error:
        assert set(error.problems) <= set(texts)
