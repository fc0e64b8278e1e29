"""The dependencies between modules: every name is a module, and there is no cycle."""

from collections.abc import Collection, Iterator, Mapping

from robbie_mp.base.problem import Problem
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import YamlNode

KEY = "depends_on"


def read_dependencies(modules: Mapping[str, YamlNode]) -> tuple[dict[str, tuple[str, ...]], list[Problem]]:
    """Return the names of the modules that each module depends on, and all problems.

    Args:
        modules: the profile's modules by name.
    """
    problems: list[Problem] = []
    entries = {name: list(_entries(name, module, problems)) for name, module in modules.items()}
    for name, nodes in entries.items():
        problems += [
            Problem(f"modules.{name}.{KEY}: {_what_is_wrong(str(node.value), name, modules)}", node.place)
            for node in nodes
            if node.value == name or node.value not in modules
        ]
    names = {name: tuple(str(node.value) for node in nodes) for name, nodes in entries.items()}
    if not problems and (cycle := _cycle(names)):
        chain = " → ".join([*cycle, cycle[0]])
        problems.append(
            Problem(f"modules.{cycle[0]}.{KEY}: expected no cycle; got {chain}", entries[cycle[0]][0].place)
        )
    return names, problems


def with_dependents(name: str, depends_on: Mapping[str, Collection[str]]) -> set[str]:
    """Return a module and those that depend on it, directly or indirectly.

    Args:
        name: the module.
        depends_on: for each module, what it depends on.
    """
    reached = {name}
    while more := {one for one, needed in depends_on.items() if not reached.isdisjoint(needed)} - reached:
        reached |= more
    return reached


def _entries(name: str, module: YamlNode, problems: list[Problem]) -> Iterator[YamlNode]:
    """Yield the names in a module's list of dependencies; report entries that are not names."""
    node = module.value.get(KEY) if isinstance(module.value, dict) else None
    if node is None:
        return
    if not isinstance(node.value, list):
        problems.append(
            Problem(f"modules.{name}.{KEY}: expected a list of modules; got {node.plain()!r:.60}", node.place)
        )
        return
    for entry in node.value:
        if isinstance(entry.value, str):
            yield entry
        else:
            text = f"modules.{name}.{KEY}: expected the name of a module; got {entry.plain()!r:.60}"
            problems.append(Problem(text, entry.place))


def _what_is_wrong(entry: str, name: str, modules: Mapping[str, YamlNode]) -> str:
    if entry == name:
        return "a module cannot depend on itself"
    others = [other for other in modules if other != name]
    return f"there is no module {entry!r}{did_you_mean(entry, others)}"


def _cycle(names: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return a cycle: modules of which each depends on the next, and the last on the first; empty if none."""
    left = dict(names)
    while free := [name for name, needed in left.items() if not any(other in left for other in needed)]:
        for name in free:
            del left[name]
    if not left:
        return []
    path = [
        next(iter(left))
    ]  # each module left depends on another one left: following these leads into a cycle
    while (following := next(other for other in left[path[-1]] if other in left)) not in path:
        path.append(following)
    return path[path.index(following) :]
