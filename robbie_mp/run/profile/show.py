"""Shows a merged profile with the origin of each value."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

import yaml

from robbie_mp.base.visible_text import visible
from robbie_mp.base.yaml_reader import Dumper
from robbie_mp.run.profile.model import ModuleSpec, Profile

DEFAULT = "default"
COMMENT_COLUMN = 48
FLOW_INDICATORS = frozenset(",[]{}")
"""What ends a text without quotes within brackets or braces (YAML 1.2.2, 7.3.3)."""
VARIABLE = re.compile(r"\$\{[^}]*\}")
KeyPath = tuple[str, ...]


@dataclass(frozen=True)
class YamlLine:
    """A line of YAML and the comment that follows it."""

    text: str
    comment: str = ""

    def __str__(self) -> str:
        return f"{self.text:<{COMMENT_COLUMN}}  # {self.comment}" if self.comment else self.text


def as_tree(profile: Profile, settings: Mapping[str, Mapping[str, object]]) -> dict[str, Any]:
    """Return the profile as maps, lists and scalars, with the keys of a profile file.

    Args:
        profile: The profile to show.
        settings: For each module, all its settings as its class takes them, as far as they are known.
    """
    modules = {module.name: _module_tree(module, settings.get(module.name, {})) for module in profile.modules}
    return {
        "description": profile.description,
        "variables": dict(profile.variables),
        "modules": modules,
        "core": _plain(profile.core),
        "spares": _plain(profile.spares),
        "trace": _plain(profile.trace),
        "tools": _plain(profile.tools),
        "black_box": profile.black_box is not None and (dict(profile.black_box.settings) or True),
    }


def _module_tree(module: ModuleSpec, settings: Mapping[str, object]) -> dict[str, Any]:
    tree = {"class": module.class_path, "settings": {**module.settings, **settings}}
    rest = _plain(module) | {"topics": dict(module.topics)}
    return tree | {
        key: rest[key] for key in rest if key not in ("name", "class_path", "settings", "folder_of", "code")
    }


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, list):
        return [_plain(element) for element in value]
    return value.value if isinstance(value, Enum) else value


def origins(profile: Profile, tree: Mapping[str, Any]) -> dict[KeyPath, str]:
    """Return for each scalar or list of the tree its file:line, the option that set it, or "default"."""
    return {path: str(profile.origins.get(path, DEFAULT)) for path in _leaves(tree, ())}


def _leaves(tree: Mapping[str, Any], path: KeyPath) -> Iterator[KeyPath]:
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key)


def without_defaults(
    tree: Mapping[str, Any], origins: Mapping[KeyPath, str], path: KeyPath = ()
) -> dict[str, Any]:
    """Return the part of a tree that a profile or an option has set; arguments as for `to_lines`."""
    changed = {}
    for key, value in tree.items():
        here = (*path, key)
        if isinstance(value, dict) and value:
            if below := without_defaults(value, origins, here):
                changed[key] = below
        elif origins[here] != DEFAULT:
            changed[key] = value
    return changed


def to_lines(
    tree: Mapping[str, Any], origins: Mapping[KeyPath, str], path: KeyPath = ()
) -> Iterator[YamlLine]:
    """Yield the tree as YAML, each value on one line with its origin as a comment."""
    indent = "  " * len(path)
    for key, value in tree.items():
        here = (*path, key)
        if isinstance(value, dict) and value:
            yield YamlLine(f"{indent}{inline(key)}:")
            yield from to_lines(value, origins, here)
        else:
            yield YamlLine(f"{indent}{inline(key)}: {inline(value)}", origins[here])


def as_profile(profile: Profile, settings: Mapping[str, Mapping[str, object]]) -> str:
    """Return the text of an equal profile without parents; arguments as for `as_tree`."""
    tree = as_tree(profile, settings)
    return "".join(f"{line.text}\n" for line in to_lines(tree, origins(profile, tree)))


def _dump(value: object, *, allow_unicode: bool) -> str:
    text: str = yaml.dump(
        value,
        Dumper=Dumper,
        default_flow_style=True,
        allow_unicode=allow_unicode,
        sort_keys=False,
        width=1 << 30,
    )
    return text


def inline(value: object) -> str:
    """Return a value as YAML on one line, as a profile may contain it, also within brackets and braces."""
    if isinstance(value, str) and not FLOW_INDICATORS.isdisjoint(value):
        return inline([value])[1:-1]  # PyYAML quotes it only there
    value = _without_variables(value)
    text = _dump(value, allow_unicode=True)
    if (
        visible(text) != text
    ):  # PyYAML would write control characters unescaped, and read some of them as blanks
        text = _dump(value, allow_unicode=False)
    return text.removesuffix("\n").removesuffix("\n...").rstrip("\n")


def _without_variables(value: object) -> object:
    """Return a value whose texts are read back as they are, though some look like variables.

    Keys stay as they are, because the reader looks for variables in values only.
    """
    if isinstance(value, str):
        return VARIABLE.sub(lambda found: f"${found[0]}", value)
    if isinstance(value, dict):
        return {key: _without_variables(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_variables(item) for item in value]
    return value
