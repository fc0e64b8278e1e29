"""Merges a profile with its parents and with the overrides of the command line."""

import re
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import NamedTuple

from robbie_mp.base.problem import Problem, ProfileError, SourcePlace, refuse
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import YamlNode, read_text
from robbie_mp.run.profile.model import BLACK_BOX
from robbie_mp.run.profile.workspace import Workspace, is_class

_WORD_BEGINS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


class Merged(NamedTuple):
    """The content of a profile, its parents and its overrides."""

    tree: YamlNode
    """A map."""
    removals: dict[tuple[str, ...], SourcePlace]
    """Where a null removes a key that none of them sets."""


def merge_profile(workspace: Workspace, name: str, overrides: Sequence[str] = ()) -> Merged:
    """Merge a profile with its parents and overrides; a class is a profile with nothing else.

    Parents come first, in their order, each before its children and each only once. If two parents share a
    parent, the changes that either makes to it are kept. Maps merge, null removes, everything else replaces.

    Raises:
        ProfileError: a file is missing or is not YAML, a profile is its own ancestor, or an override has
            another form than `MODULE.SETTING=value`, or names no module of the profile, nor its black box.
    """
    lineage: dict[str, YamlNode] = {}
    if is_class(name):
        lineage[name] = _profile_of_class(name)
    else:
        _collect(workspace, name, (), None, lineage)
    profile = reduce(merge, lineage.values(), YamlNode({}, lineage[name].place))
    over = [_read_override(text, profile) for text in overrides]
    return Merged(reduce(merge, over, profile), _removals([*lineage.values(), *over]))


def merge(base: YamlNode | None, over: YamlNode) -> YamlNode:
    """Return `base` overridden by `over`; new keys come last."""
    if not isinstance(over.value, dict):
        return over
    merged = dict(base.value) if base and isinstance(base.value, dict) else {}
    for key, child in over.value.items():
        if child.value is None:
            merged.pop(key, None)
        else:
            merged[key] = merge(merged.get(key), child)
    return YamlNode(merged, over.place)


def _removals(trees: Sequence[YamlNode]) -> dict[tuple[str, ...], SourcePlace]:
    nodes = [found for tree in trees for found in _keys(tree)]
    given = {path for path, node in nodes if node.value is not None}
    return {path: node.place for path, node in nodes if path not in given}


def _keys(tree: YamlNode, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], YamlNode]]:
    for key, child in tree.value.items() if isinstance(tree.value, dict) else ():
        yield (*path, key), child
        yield from _keys(child, (*path, key))


def _collect(
    workspace: Workspace,
    name: str,
    children: tuple[str, ...],
    place: SourcePlace | None,
    lineage: dict[str, YamlNode],
) -> None:
    """Add a profile to the lineage after its parents; `place` is where its child names it."""
    if name in children:
        chain = " → ".join((*children[children.index(name) :], name))
        raise refuse(f"parents: a profile cannot be its own ancestor: {chain}", place)
    if name in lineage:
        return
    content = workspace.read(name, place)
    for parent in _names(content.value.get("parents") if isinstance(content.value, dict) else None):
        _collect(workspace, str(parent.value), (*children, name), parent.place, lineage)
    lineage[name] = content


def _names(parents: YamlNode | None) -> list[YamlNode]:
    if parents is None or parents.value is None:
        return []
    if not isinstance(parents.value, list):
        raise refuse("parents: expected a list of profile names, as in `parents: [base]`", parents.place)
    problems = [
        Problem(f"parents: expected the name of a profile; got {parent.plain()!r:.60}", parent.place)
        for parent in parents.value
        if not isinstance(parent.value, str)
    ]
    if problems:
        raise ProfileError(problems)
    return parents.value


def _profile_of_class(class_path: str) -> YamlNode:
    """Return the profile of one module, named as its class, in small letters; it has no black box."""
    place = SourcePlace(class_path)
    name = _WORD_BEGINS.sub("_", class_path.rpartition(":")[2]).strip("_").lower()
    module = YamlNode({"class": YamlNode(class_path, place)}, place)
    modules = YamlNode({name: module}, place)
    return YamlNode({"modules": modules, BLACK_BOX: YamlNode(False, place)}, place)


def _read_override(text: str, profile: YamlNode) -> YamlNode:
    key, equals, value_text = text.partition("=")
    option = f"--set {key}"  # without the value, which may be a secret
    place = SourcePlace(option)
    name, _, setting = key.partition(".")
    if not (equals and name and setting):
        raise refuse("expected MODULE.SETTING=VALUE", place)
    modules = _modules(profile)
    if name == BLACK_BOX and name not in modules:
        box = profile.value.get(BLACK_BOX) if isinstance(profile.value, dict) else None
        if box is not None and box.value is False:
            raise refuse("the profile has no black box (black_box: false)", place)
        path: tuple[str, ...] = (BLACK_BOX, setting)
    elif name in modules:
        path = ("modules", name, "settings", setting)
    else:
        near = did_you_mean(name, modules) or f"; modules: {', '.join(modules) or 'none'}"
        raise refuse(f"there is no module {name!r}{near}", place)
    value = YamlNode(read_text(value_text, option).value, place)
    return reduce(lambda inner, step: YamlNode({step: inner}, place), reversed(path), value)


def _modules(profile: YamlNode) -> list[str]:
    node = profile.value.get("modules") if isinstance(profile.value, dict) else None
    return list(node.value) if node and isinstance(node.value, dict) else []
