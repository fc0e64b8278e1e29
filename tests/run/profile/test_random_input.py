"""Any input in a profile or on the command line gives a profile or a ProfileError."""

import tempfile
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from robbie_mp.base.problem import ProfileError, SourcePlace
from robbie_mp.base.yaml_reader import YamlNode, read_text
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.merge import merge
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.show import inline
from robbie_mp.run.profile.variables import resolve

WORDS = (
    "parents description modules variables core class settings restart policy memory segment_bytes "
    "limit_bytes essential queue bytes ring_records a a.b demo"
)
KEYS = st.sampled_from(WORDS.split()) | st.text(max_size=5)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(["m:A", "always", "never", "demo", "other"])
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)
# Characters that mean something in YAML, so that random text often gets past the first one.
YAML_TEXT = st.text(st.sampled_from("ab1:-?,[]{}#&*!|>'\"%@` \n\t.~<=\\xU0") | st.characters(), max_size=60)
FORM = st.fixed_dictionaries(
    {},
    optional={
        "parents": st.lists(st.sampled_from(["demo", "other", "lost"]), max_size=2) | VALUES,
        "modules": st.dictionaries(KEYS, st.dictionaries(KEYS, VALUES, max_size=4) | VALUES, max_size=3)
        | VALUES,
        "variables": st.dictionaries(KEYS, SCALARS, max_size=3) | VALUES,
        "core": st.dictionaries(KEYS, SCALARS, max_size=3) | VALUES,
    },
)


def check(demo: str, other: str = "", overrides: tuple[str, ...] = ()) -> None:
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root, "profiles")
        folder.mkdir()
        (folder / "demo.yaml").write_text(demo, encoding="utf-8", errors="surrogatepass")
        (folder / "other.yaml").write_text(other, encoding="utf-8", errors="surrogatepass")
        try:
            profile = load_profile("demo", Path(root), overrides)
        except ProfileError as error:
            assert error.problems and str(error)
        else:
            assert isinstance(profile, Profile)


@given(YAML_TEXT)
def test_any_text_is_a_profile_or_a_profile_error(text: str) -> None:
    check(text)


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.too_slow])  # the machine may be busy
@given(FORM, FORM)
def test_any_values_are_a_profile_or_a_profile_error(demo: object, other: object) -> None:
    check(yaml.dump(demo, allow_unicode=True), yaml.dump(other, allow_unicode=True))


@given(YAML_TEXT, st.sampled_from(["", "a.x=", "k=", "k", "a.", "b.x="]))
def test_any_override_is_accepted_or_a_profile_error(text: str, beginning: str) -> None:
    check("modules: {a: {class: 'm:A'}}\nvariables: {k: 1}", overrides=(beginning + text,))


@given(st.binary(max_size=40))
@settings(max_examples=50)
def test_any_bytes_are_a_profile_or_a_profile_error(content: bytes) -> None:
    check(content.decode("latin-1"))


def node(value: object) -> YamlNode:
    place = SourcePlace("test")
    if isinstance(value, dict):
        return YamlNode({key: node(child) for key, child in value.items()}, place)
    assert value is None or isinstance(value, int)
    return YamlNode(value, place)


TREES = st.dictionaries(
    st.sampled_from("abc"),
    st.recursive(
        st.none() | st.integers(0, 9),
        lambda inner: st.dictionaries(st.sampled_from("abc"), inner),
        max_leaves=6,
    ),
)


@given(TREES, TREES)
def test_merging_agrees_with_its_definition(base: dict[str, object], over: dict[str, object]) -> None:
    def without_nulls(value: object) -> object:
        if isinstance(value, dict):
            return {key: without_nulls(child) for key, child in value.items() if child is not None}
        return value

    def expected(below: object, above: object) -> object:
        if not (isinstance(below, dict) and isinstance(above, dict)):
            return without_nulls(above)
        merged = {key: value for key, value in below.items() if key not in above or above[key] is not None}
        for key, value in above.items():
            if value is not None:
                merged[key] = expected(below.get(key), value)
        return merged

    clean = merge(None, node(base))
    assert clean.plain() == without_nulls(base)
    assert merge(clean, node(over)).plain() == expected(without_nulls(base), over)


@given(VALUES)
@example({"${a}": "${a}"})
@example("0,")
@example(["$${", "$${a}", {"a${b}": "$$${b} ${${c}} ${"}])
def test_shown_value_is_read_back_as_it_was(value: object) -> None:
    assume("'if'" not in repr(value))  # a map with this key may be left out
    try:
        shown = read_text(f"modules: {{x: {inline(value)}}}", Path("p.yaml"))
        profile = resolve(shown).tree.plain()
        assert isinstance(profile, dict)
        got = profile["modules"]["x"]
    except ProfileError as error:
        assert "64 bits" in str(error) or "<<" in str(error)
    else:
        assert repr(got) == repr(value)  # so that nan equals nan, and 1 differs from 1.0
