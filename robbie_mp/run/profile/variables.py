"""Variables, conditions and left-out modules: what varies between runs of one profile.

All of it happens after the profile has been merged with its parents and `--set`, and before it is checked:

1. A variable has its default from `variables`, or the value of `--var`, which must have the same type.
2. A module whose `if` is false is left out, and so are those named by `--without`, and all but those of
   `--only`.
3. `${name}` is replaced in all values. A value that is nothing else keeps the variable's type.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from robbie_mp.base.problem import Problem, ProfileError, SourcePlace
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import YamlNode, read_text
from robbie_mp.run.profile.dependencies import KEY as DEPENDS_ON
from robbie_mp.run.profile.model import BLACK_BOX

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
REFERENCE = re.compile(r"\$?\$\{([^}]*)\}")
"""A variable in a text; with two dollar signs it is not one, and one of them is removed."""
WORD = re.compile(r"\s*(\$\{[^}]*\}|[()]|[^\s()]+)")
SCALARS = (bool, int, float, str)
Trees = dict[str, YamlNode]


class Resolved(NamedTuple):
    """A profile without variables and conditions."""

    tree: YamlNode
    left_out: dict[str, str]
    """Why each module is not in the tree, by its name."""


def resolve(
    tree: YamlNode, settings: Sequence[str] = (), without: Sequence[str] = (), only: Sequence[str] = ()
) -> Resolved:
    """Replace the variables of a merged profile, and leave out the modules that shall not run.

    Args:
        tree: the profile, merged with its parents and overrides.
        settings: each `NAME=VALUE` of the command line, the value in YAML.
        without: the names of modules to leave out.
        only: the names of the modules to keep; none: all.

    Raises:
        ProfileError: it lists unknown variables, wrong values and conditions, and unknown modules.
    """
    resolver = _Resolver(tree)
    resolved = resolver.resolve(settings, without, only)
    if resolver.problems:
        raise ProfileError(resolver.problems)
    return resolved


class _Resolver:
    """Collects problems while it resolves."""

    def __init__(self, tree: YamlNode) -> None:
        self.tree = tree
        self.problems: list[Problem] = []
        self.variables: Trees = {}

    def resolve(self, settings: Sequence[str], without: Sequence[str], only: Sequence[str]) -> Resolved:
        content = _map_of(self.tree)
        if content is None:
            return Resolved(self.tree, {})  # which is reported when the profile is built
        self.variables = dict(self._declared(content.get("variables")))
        for text in settings:
            self._set(text)
        modules = _map_of(content.get("modules")) or {}
        has_box = BLACK_BOX not in modules  # else it is a module like others
        if has_box and BLACK_BOX in without:
            without = [name for name in without if name != BLACK_BOX]
            place = SourcePlace(f"--without {BLACK_BOX}")
            content = {**content, BLACK_BOX: YamlNode(False, place)}
        if has_box and set(only) > {BLACK_BOX}:
            only = [name for name in only if name != BLACK_BOX]  # which stays anyway
        left_out = self._left_out(modules, without, only)
        kept = {
            name: _without_names(_without_condition(module), left_out)
            for name, module in modules.items()
            if name not in left_out
        }
        self._check_clock(content.get("clock"), left_out)
        whole = dict(content)
        if "modules" in content and modules:
            whole["modules"] = replace(content["modules"], value=kept)
        replaced = {key: self._replaced(node) for key, node in whole.items() if key != "variables"}
        if "variables" in content:
            replaced["variables"] = replace(content["variables"], value=dict(self.variables))
        return Resolved(replace(self.tree, value=replaced), left_out)

    # -- variables ---------------------------------------------------------------------------------------

    def _declared(self, section: YamlNode | None) -> Iterator[tuple[str, YamlNode]]:
        if section is None:
            return
        declared = _map_of(section)
        if declared is None:
            self._report(section.place, f"variables: expected a map; got {section.plain()!r:.60}")
        for name, node in (declared or {}).items():
            where = f"variables.{name}"
            if not NAME.fullmatch(name):
                self._report(node.place, f"{where}: expected a name of letters, digits and _")
            elif not isinstance(node.value, SCALARS):
                self._report(
                    node.place, f"{where}: expected bool, int, float or str; got {node.plain()!r:.60}"
                )
            elif isinstance(node.value, str) and REFERENCE.search(node.value):
                self._report(node.place, f"{where}: a variable cannot contain another one; write its value")
            else:
                yield name, node

    def _set(self, text: str) -> None:
        """Give a variable the value of one `--var`."""
        name, equals, value_text = text.partition("=")
        place = SourcePlace(f"--var {name}")
        if not (equals and name):
            self._report(place, "expected NAME=VALUE")
            return
        default = self.variables.get(name)
        if default is None:
            self._report(place, self._unknown(name))
            return
        value = read_text(value_text, str(place)).value
        if isinstance(default.value, str) and not isinstance(value, str | dict | list | None):
            value = value_text.strip()  # 7 is a text where a text is wanted
        if isinstance(default.value, float) and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if type(value) is not type(default.value):
            expected = f"expected {type(default.value).__name__}, as its default at {default.place}"
            self._report(place, f"{expected}; got {value_text!r:.60}")
            return
        self.variables[name] = YamlNode(value, place)

    def _unknown(self, name: str) -> str:
        near = did_you_mean(name, self.variables)
        known = f"; variables: {', '.join(self.variables) or 'none, declare it under `variables:`'}"
        return f"there is no variable {name!r}{near or known}"

    def _replaced(self, node: YamlNode) -> YamlNode:
        """Return a value with the variables in it replaced."""
        if isinstance(node.value, dict):
            return replace(node, value={key: self._replaced(child) for key, child in node.value.items()})
        if isinstance(node.value, list):
            return replace(node, value=[self._replaced(child) for child in node.value])
        if not isinstance(node.value, str) or "${" not in node.value:
            return node
        whole = REFERENCE.fullmatch(node.value)
        if whole and not node.value.startswith("$$"):
            variable = self._named(whole[1], node.place)
            return (
                node
                if variable is None
                else YamlNode(variable.value, replace(node.place, via=variable.place))
            )
        return replace(node, value=REFERENCE.sub(lambda found: self._inserted(found, node.place), node.value))

    def _inserted(self, found: re.Match[str], place: SourcePlace) -> str:
        if found[0].startswith("$$"):
            return found[0][1:]
        variable = self._named(found[1], place)
        if variable is None:
            return ""
        value = variable.value
        return str(value).lower() if isinstance(value, bool) else str(value)

    def _named(self, name: str, place: SourcePlace) -> YamlNode | None:
        variable = self.variables.get(name)
        if variable is None:
            self._report(place, f"${{{name}}}: {self._unknown(name)}")
        return variable

    # -- modules -----------------------------------------------------------------------------------------

    def _left_out(self, modules: Trees, without: Sequence[str], only: Sequence[str]) -> dict[str, str]:
        left_out: dict[str, str] = {}
        for name, module in modules.items():
            condition = (_map_of(module) or {}).get("if")
            if condition is not None and not self._holds(f"modules.{name}.if", condition):
                left_out[name] = f"if: {condition.plain()}"
        for name in without:
            self._check_name("--without", name, modules)
            left_out.setdefault(name, f"--without {name}")
        for name in only:
            self._check_name("--only", name, modules)
            if name in left_out:
                self._report(SourcePlace(f"--only {name}"), f"{name} is left out ({left_out[name]})")
        if only:
            why = f"--only {','.join(only)}"
            left_out = {name: why for name in modules if name not in only} | left_out
        return left_out

    def _check_name(self, option: str, name: str, modules: Trees) -> None:
        if name not in modules:
            near = did_you_mean(name, modules) or f"; modules: {', '.join(modules) or 'none'}"
            if name == BLACK_BOX:
                near = " in the profile: it runs beside those that you name"
            self._report(SourcePlace(f"{option} {name}"), f"there is no module {name!r}{near}")

    def _check_clock(self, clock: YamlNode | None, left_out: Mapping[str, str]) -> None:
        source = (_map_of(clock) or {}).get("source")
        if source is not None and isinstance(source.value, str) and source.value in left_out:
            text = f"{source.value} is left out ({left_out[source.value]}), but it turns the clock"
            self._report(source.place, f"clock.source: {text}")

    def _holds(self, where: str, condition: YamlNode) -> bool:
        """Return whether a condition holds; True if it is wrong, which is reported."""
        if isinstance(condition.value, bool):
            return condition.value
        try:
            if not isinstance(condition.value, str):
                raise _WrongCondition(f"got {condition.plain()!r:.60}")
            return _Condition(condition.value, self._truth).value()
        except _WrongCondition as error:
            expected = "expected true, false, or variables with and, or, not, as in `${a} and not ${b}`"
            self._report(condition.place, f"{where}: {expected}; {error}")
            return True

    def _truth(self, name: str) -> bool:
        variable = self.variables.get(name)
        if variable is None:
            raise _WrongCondition(self._unknown(name))
        if not isinstance(variable.value, bool):
            kind = type(variable.value).__name__
            raise _WrongCondition(f"{name} is {variable.value!r} ({kind}, {variable.place}), not a bool")
        return variable.value

    def _report(self, place: SourcePlace, text: str) -> None:
        self.problems.append(Problem(text, place))


class _WrongCondition(Exception):
    """A condition cannot be understood; the text says why."""


class _Condition:
    """Variables joined by `and`, `or`, `not` and parentheses, which bind as in Python."""

    def __init__(self, text: str, truth: Callable[[str], bool]) -> None:
        self._words = WORD.findall(text)
        self._truth = truth

    def value(self) -> bool:
        """Return whether it holds."""
        result = self._either()
        if self._words:
            raise _WrongCondition(f"'{self._words[0]}' follows where the condition should end")
        return result

    def _either(self) -> bool:
        result = self._both()
        while self._next_is("or"):
            result = self._both() or result
        return result

    def _both(self) -> bool:
        result = self._one()
        while self._next_is("and"):
            result = self._one() and result
        return result

    def _one(self) -> bool:
        if not self._words:
            raise _WrongCondition("a variable is missing at the end")
        word = self._words.pop(0)
        if word == "not":
            return not self._one()
        if word == "(":
            result = self._either()
            if not self._next_is(")"):
                raise _WrongCondition("a closing parenthesis is missing")
            return result
        if word in ("true", "false"):
            return bool(word == "true")
        if found := REFERENCE.fullmatch(word):
            return self._truth(found[1])
        raise _WrongCondition(f"'{word}' is not a variable; write ${{{word}}}")

    def _next_is(self, word: str) -> bool:
        if self._words[:1] == [word]:
            del self._words[0]
            return True
        return False


def _map_of(node: YamlNode | None) -> Trees | None:
    return node.value if node is not None and isinstance(node.value, dict) else None


def _without_condition(module: YamlNode) -> YamlNode:
    content = _map_of(module)
    if content is None or "if" not in content:
        return module
    return replace(module, value={key: node for key, node in content.items() if key != "if"})


def _without_names(module: YamlNode, left_out: Mapping[str, str]) -> YamlNode:
    """Return a module that does not depend on modules that are left out."""
    content = _map_of(module)
    needed = content.get(DEPENDS_ON) if content else None
    if content is None or needed is None or not isinstance(needed.value, list):
        return module
    kept = [node for node in needed.value if not (isinstance(node.value, str) and node.value in left_out)]
    return replace(module, value=content | {DEPENDS_ON: replace(needed, value=kept)})
