"""Builds the profile from its merged tree, and reports everything that is wrong with it."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from robbie_mp.base.problem import Problem, ProfileError, SourcePlace
from robbie_mp.base.suggest import did_you_mean, space_missing
from robbie_mp.base.yaml_reader import YamlNode
from robbie_mp.bus.transport.layout import NAME_BYTES
from robbie_mp.module.value_check import NO_LIMITS, ValueMismatch, check_value
from robbie_mp.module.wiring import InvalidTopic, check_topic
from robbie_mp.run.profile.dependencies import read_dependencies
from robbie_mp.run.profile.model import (
    BLACK_BOX,
    FOLLOWED,
    CheckpointPolicy,
    ClockSettings,
    CoreLimits,
    MemoryLimits,
    ModuleSpec,
    Profile,
    QueueLimits,
    RestartPolicy,
    Scheduling,
    SpareInterpreters,
    ToolLimits,
    TraceSettings,
)
from robbie_mp.run.profile.workspace import CLASS_PATH

PROGRAM_KEY = "program"
PROGRAM_CLASS = "robbie_mp.run.program.module:Program"
"""What a module is whose entry has `program` instead of `class`."""
T = TypeVar("T")
PROFILE_KEYS = (
    "parents",
    "description",
    "variables",
    "namespace",
    "modules",
    "core",
    "spares",
    "trace",
    "tools",
    "clock",
    "black_box",
)
MODULE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,47}")
RESERVED_NAMES = ("core", "supervisor")
NAMESPACE = re.compile(r"[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*")


def build_profile(
    name: str,
    tree: YamlNode,
    removals: Mapping[tuple[str, ...], SourcePlace],
    *,
    workspace: Path,
    current_folder: Path,
) -> Profile:
    """Return the profile that a merged tree describes.

    Args:
        name: The profile's name.
        tree: What `merge_profile` returned, without variables and conditions.
        removals: What `merge_profile` returned.
        workspace: Relative paths in files start from this folder.
        current_folder: Relative paths on the command line start from this folder.

    Raises:
        ProfileError: The tree is not a valid profile; it lists every problem.
    """
    builder = _Builder(current_folder, removals)
    profile = builder.profile(name, tree, workspace)
    if builder.problems:
        raise ProfileError(builder.problems)
    return profile


class _Builder:
    """Collects problems while it builds; it replaces wrong values by defaults to find the next problem."""

    def __init__(self, current_folder: Path, removals: Mapping[tuple[str, ...], SourcePlace]) -> None:
        self.current_folder = current_folder
        box = ("modules", BLACK_BOX, "settings")
        self.removals = {
            (*box, *path[1:]) if path[0] == BLACK_BOX else path: place
            for path, place in removals.items()
            if path[2:] != ("if",)
        }
        self.problems: list[Problem] = []
        self.depends_on: dict[str, tuple[str, ...]] = {}
        self.default_namespace = ""

    def profile(self, name: str, tree: YamlNode, workspace: Path) -> Profile:
        content = self.map_of(tree, "profile")
        self.refuse_unknown(content, PROFILE_KEYS, "")
        modules = self.map_of(content.get("modules"), "modules")
        self.refuse_removals(content, modules)
        self.depends_on, problems = read_dependencies(modules)
        self.problems += problems
        self.default_namespace = self.namespace(content)
        return Profile(
            name=name,
            modules=tuple(self.module(key, node, modules) for key, node in modules.items()),
            core=self.core(self.map_of(content.get("core"), "core")),
            spares=self.section(SpareInterpreters, self.map_of(content.get("spares"), "spares"), "spares"),
            trace=self.section(TraceSettings, self.map_of(content.get("trace"), "trace"), "trace"),
            tools=self.section(ToolLimits, self.map_of(content.get("tools"), "tools"), "tools"),
            clock=self.clock(self.map_of(content.get("clock"), "clock"), modules),
            black_box=self.black_box(content, modules),
            description=self.value(str, content.get("description"), "description", ""),
            variables={
                name: node.value for name, node in self.map_of(content.get("variables"), "variables").items()
            },
            workspace=workspace,
            origins=self.removals | self.inherited_origins(content, modules) | _origins(tree),
            removals=self.removals,
        )

    def core(self, content: dict[str, YamlNode]) -> CoreLimits:
        restart = self.nested(RestartPolicy, content, "core", "restart", CoreLimits().restart)
        scheduling = self.nested(Scheduling, content, "core", "scheduling")
        return self.section(CoreLimits, content, "core", restart=restart, scheduling=scheduling)

    def clock(self, content: dict[str, YamlNode], modules: dict[str, YamlNode]) -> ClockSettings:
        clock = self.section(ClockSettings, content, "clock")
        if clock.follow:
            return self.followed_clock(clock, content["follow"].place, modules)
        if clock.source is not None and clock.source not in modules:
            near = f"there is no module {clock.source!r}{did_you_mean(clock.source, modules)}"
            self.report(content["source"].place, f"clock.source: {near}")
        if clock.lockstep and clock.source is None:
            text = "clock.lockstep: expected clock.source to name the module that grants each step"
            self.report(content["lockstep"].place, text)
        if clock.charge and not clock.lockstep:
            text = "clock.charge: expected clock.lockstep: true; handlers take their own time otherwise"
            self.report(content["charge"].place, text)
        return clock

    def followed_clock(
        self, clock: ClockSettings, place: SourcePlace, modules: dict[str, YamlNode]
    ) -> ClockSettings:
        wanted = FOLLOWED.get(clock.follow)
        if wanted is None:
            self.report(place, f"clock.follow: expected {', '.join(FOLLOWED)}; got {clock.follow!r:.60}")
            return clock
        if clock.source is not None or clock.lockstep:
            self.report(place, "clock.follow: expected neither clock.source nor clock.lockstep beside it")
        contents = {name: node.value for name, node in modules.items() if isinstance(node.value, dict)}
        classes = {name: one.get("class") for name, one in contents.items()}
        found = [name for name, node in classes.items() if node is not None and node.value == wanted]
        if len(found) != 1:
            self.report(
                place, f"clock.follow: expected one module of the class {wanted}; there are {len(found)}"
            )
            return clock
        return replace(clock, source=found[0])

    def module(self, name: str, node: YamlNode, siblings: dict[str, YamlNode]) -> ModuleSpec:
        where = f"modules.{name}"
        if not MODULE_NAME.fullmatch(name):
            self.report(node.place, f"{where}: expected a name of at most 48 letters, digits, _ and -")
        if name in RESERVED_NAMES:
            self.report(node.place, f"{where}: this name is taken by the framework; use another")
        content = self.without_program(self.map_of(node, where), where)
        settings = self.map_of(content.get("settings"), f"{where}.settings")
        typed_in = [key for key, value in settings.items() if value.place.is_typed]
        return self.section(
            ModuleSpec,
            content,
            where,
            name=name,
            class_path=self.class_path(node, content, where, [other for other in siblings if other != name]),
            settings={key: value.plain() for key, value in settings.items()},
            topics=self.topics(content, where),
            namespace=self.namespace(content, where) if "namespace" in content else self.default_namespace,
            folder_of=dict.fromkeys(typed_in, self.current_folder),
            restart=self.nested(RestartPolicy, content, where, "restart"),
            depends_on=self.depends_on[name],
            memory=self.memory(content, where),
            queue=self.nested(QueueLimits, content, where, "queue"),
            checkpoint=self.nested(CheckpointPolicy, content, where, "checkpoint"),
            scheduling=self.nested(Scheduling, content, where, "scheduling"),
        )

    def black_box(self, content: dict[str, YamlNode], modules: dict[str, YamlNode]) -> ModuleSpec | None:
        """Build the module that keeps the last messages, unless the profile has it already or wants none."""
        node = content.get(BLACK_BOX)
        lockstep = self.map_of(content.get("clock"), "clock").get("lockstep")
        is_unwanted = node is not None and node.value is False
        if is_unwanted or BLACK_BOX in modules or (lockstep is not None and lockstep.value is True):
            return None
        is_plain = node is None or node.value is True
        settings = {} if is_plain else self.map_of(node, BLACK_BOX)
        return ModuleSpec(
            name=BLACK_BOX,
            class_path="robbie_mp.logs.black_box.module:BlackBox",
            settings={key: value.plain() for key, value in settings.items()},
            queue=QueueLimits(messages=4000),
            stop_grace_s=20.0,
        )

    def without_program(self, content: dict[str, YamlNode], where: str) -> dict[str, YamlNode]:
        """Return what a module's keys mean: `program` stands for the class that runs programs."""
        program = content.get(PROGRAM_KEY)
        if program is None:
            return content
        if "class" in content:
            self.report(program.place, f"{where}: expected either class or program, not both")
        settings = self.map_of(content.get("settings"), f"{where}.settings") | {"command": program}
        rest = {key: node for key, node in content.items() if key != PROGRAM_KEY}
        place = program.place
        return rest | {"class": YamlNode(PROGRAM_CLASS, place), "settings": YamlNode(dict(settings), place)}

    def inherited_origins(
        self, content: dict[str, YamlNode], modules: dict[str, YamlNode]
    ) -> dict[tuple[str, ...], SourcePlace]:
        """The places of values that the modules have from the profile as a whole."""
        box = content.get(BLACK_BOX)
        settings = box.value if box is not None and isinstance(box.value, dict) else {}
        found: dict[tuple[str, ...], SourcePlace] = {
            ("modules", BLACK_BOX, "settings", name): value.place for name, value in settings.items()
        }
        if (node := content.get("namespace")) is not None:
            found |= {("modules", name, "namespace"): node.place for name in modules}
        return found

    def topics(self, module: dict[str, YamlNode], where: str) -> dict[str, str]:
        found: dict[str, str] = {}
        for own, node in self.map_of(module.get("topics"), f"{where}.topics").items():
            name = node.value
            if not isinstance(name, str):
                self.report(
                    node.place,
                    f"{where}.topics.{own}: expected the name of a topic; got {node.plain()!r:.60}",
                )
            elif max(len(own.encode()), len(name.encode())) > NAME_BYTES:
                text = f"{where}.topics.{own}: expected names of at most {NAME_BYTES} bytes"
                self.report(node.place, text)
            elif flaw := _topic_flaw(name):
                self.report(node.place, f"{where}.topics.{own}: {flaw}")
            elif own == name:
                self.report(node.place, f"{where}.topics.{own}: expected another name than {own!r}")
            else:
                found[own] = name
        return found

    def namespace(self, content: dict[str, YamlNode], where: str = "") -> str:
        node = content.get("namespace")
        if node is None or node.value == "":
            return ""
        if not isinstance(node.value, str) or not NAMESPACE.fullmatch(node.value):
            place = f"{where}.namespace" if where else "namespace"
            expected = "expected letters, digits, _ and -, with / between parts, as in red or team/red"
            self.report(node.place, f"{place}: {expected}; got {node.plain()!r:.60}")
            return ""
        return node.value

    def class_path(
        self, module: YamlNode, content: dict[str, YamlNode], where: str, siblings: list[str]
    ) -> str:
        node = content.get("class")
        if not isinstance(module.value, dict):
            return ""  # which has already been reported
        if node is None:
            near = did_you_mean(where.removeprefix("modules."), siblings)
            self.report(module.place, f"{where}: has no class{near or '; expected package.module:Class'}")
            return ""
        if not isinstance(node.value, str) or not CLASS_PATH.fullmatch(node.value):
            self.report(node.place, f"{where}.class: expected package.module:Class; got {node.plain()!r:.60}")
        return str(node.value)

    def memory(self, module: dict[str, YamlNode], where: str) -> MemoryLimits:
        memory = self.nested(MemoryLimits, module, where, "memory")
        if memory.limit_bytes < memory.segment_bytes:
            self.report(
                module["memory"].place,
                f"{where}.memory: expected limit_bytes to be at least segment_bytes, {memory.segment_bytes}; "
                f"got {memory.limit_bytes}",
            )
        return memory

    def nested(
        self, cls: type[T], content: dict[str, YamlNode], where: str, key: str, default: T | None = None
    ) -> T:
        where = f"{where}.{key}"
        return self.section(cls, self.map_of(content.get(key), where), where, default)

    def section(
        self,
        cls: type[T],
        content: dict[str, YamlNode],
        where: str,
        default: T | None = None,
        **built: object,
    ) -> T:
        """Build a dataclass from the map of its fields.

        A field that is not in the map has its value from `default`, or else the default of the class. Fields
        in `built` are already built.
        """
        hints = get_type_hints(cls)
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        keys = {"class" if name == "class_path" else name for name in names} - {"name", "folder_of", "code"}
        self.refuse_unknown(content, sorted(keys | {PROGRAM_KEY} if cls is ModuleSpec else keys), f"{where}.")
        values: dict[str, Any] = {**(vars(default) if default is not None else {}), **built}
        for field in fields(cls):  # type: ignore[arg-type]
            if field.name in content and field.name not in built:
                limits = field.metadata.get("limits", NO_LIMITS)
                node, place = content[field.name], f"{where}.{field.name}"
                values[field.name] = self.value(hints[field.name], node, place, field.default, limits)
        return cls(**values)

    def value(
        self, declared: Any, node: YamlNode | None, where: str, default: Any, limits: Any = NO_LIMITS
    ) -> Any:
        if node is None:
            return default
        try:
            return check_value(declared, node.plain(), limits, name=where.rpartition(".")[2])
        except ValueMismatch as mismatch:
            self.report(node.place, f"{where}: {mismatch}")
            return default

    def map_of(self, node: YamlNode | None, where: str) -> dict[str, YamlNode]:
        if node is None:
            return {}
        if isinstance(node.value, dict):
            return node.value
        self.report(node.place, f"{where}: expected a map; got {node.plain()!r:.60}")
        return {}

    def refuse_unknown(self, content: dict[str, YamlNode], known: Sequence[str], prefix: str) -> None:
        places = {key: node.place for key, node in content.items()}
        for path, place in self.removals.items():
            if prefix == "".join(f"{one}." for one in path[:-1]):
                places[path[-1]] = place
        for key, place in places.items():
            if key not in known:
                near = space_missing(key) or did_you_mean(key, known)
                self.report(
                    place, f"{prefix}{key}: unknown key" + (near or f"; expected one of {', '.join(known)}")
                )

    def refuse_removals(self, content: dict[str, YamlNode], modules: dict[str, YamlNode]) -> None:
        """Report each module, variable and topic that a null removes although no profile has it."""
        for path, place in self.removals.items():
            known: Collection[str] = ()
            match path:
                case ("modules", _):
                    kind, known = "module", modules
                case ("variables", _):
                    kind, known = "variable", self.map_of(content.get("variables"), "variables")
                case ("modules", _, "topics", _):
                    kind = "topic"
                case _:
                    continue
            near = space_missing(path[-1]) or did_you_mean(path[-1], known)
            self.report(place, f"{'.'.join(path)}: there is no {kind} {path[-1]!r} to remove{near}")

    def report(self, place: SourcePlace, text: str) -> None:
        self.problems.append(Problem(text, place))


def _topic_flaw(name: str) -> str:
    try:
        check_topic(name)
    except InvalidTopic as error:
        return str(error)
    return ""


def _origins(tree: YamlNode, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], SourcePlace]:
    origins = {path: tree.place} if path else {}
    if isinstance(tree.value, dict):
        for key, child in tree.value.items():
            origins |= _origins(child, (*path, key))
    return origins
