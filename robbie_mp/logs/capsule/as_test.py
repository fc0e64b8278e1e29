"""Writes a test that crashes as a capsule does, with as few messages as possible, as an author writes it."""

import json
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp.base.linux.address_space import limited_address_space
from robbie_mp.base.linux.private_files import write_private
from robbie_mp.bus.transport.history import Event
from robbie_mp.logs.capsule.attempt import Progress, attempt
from robbie_mp.logs.capsule.form import StartForm
from robbie_mp.logs.capsule.place import HANG, Crash, reported_crash
from robbie_mp.logs.capsule.read import Capsule, Step
from robbie_mp.logs.capsule.replayed import base_state, load_capsule_class, relocated, seed_random
from robbie_mp.messages import SettingChange, replace
from robbie_mp.messages.calls import Goal, Reply, Request
from robbie_mp.messages.message import Message, fields_of
from robbie_mp.messages.stock.registry import stock_registry
from robbie_mp.module.calls.peers import topic_of_service
from robbie_mp.module.harness import ModuleHarness

MOST_ATTEMPTS = 400
HANG_S = 10.0
"""A test that hangs ends after this time."""
SHOWN_ITEMS = 12
"""A longer array is written as zeros or ones, or as its bytes."""
SURE = 3
"""So often in a row the shortened test must crash; else it may do so by chance."""
_NOT_FINITE = re.compile(r"-?\b(?:nan|inf)\b")


@dataclass(frozen=True)
class Act:
    """One line of the test.

    Attributes:
        time_s: moves the time forward first.
        message: sent to the module; None: only time passes.
        topic, sender: of the message.
    """

    time_s: float = 0.0
    message: Message | None = None
    topic: str = ""
    sender: str = "test"


@dataclass
class Scene:
    """What the test is made of."""

    capsule: Capsule
    workspace: Path
    limit_s: float
    settings: dict[str, Any]
    restored: Any
    seeded: bool = False
    attempts: int = 0

    def crash(self, acts: Sequence[Act]) -> Crash:
        """Return how the module crashes in the test."""
        self.attempts += 1

        def act(progress: Progress, _details: dict[str, Any]) -> None:
            if self.seeded:
                seed_random(self.capsule.manifest.start.seed)
            self._play(acts, progress)

        return attempt(act, limit_s=self.limit_s).crash

    def _play(self, acts: Sequence[Act], progress: Progress) -> None:
        start = self.capsule.manifest.start
        module_class = load_capsule_class(self.capsule, self.workspace)
        harness = ModuleHarness(
            module_class,
            self.settings,
            name=start.module,
            restored=self.restored,
            topics=start.topics,
            namespace=start.namespace,
            folder=self.workspace,
        )
        progress.show(0)
        with limited_address_space(start.more_bytes), harness:
            for number, one in enumerate(acts):
                progress.show(number + 1)
                perform(harness, one)


def perform(harness: ModuleHarness[Any], one: Act) -> None:
    """Do what a line of the test says."""
    message = one.message
    if one.time_s or message is None:
        harness.advance(one.time_s)
    if isinstance(message, SettingChange):
        import yaml  # noqa: PLC0415

        harness.change_setting(message.setting, yaml.safe_load(message.value))
    elif isinstance(message, Reply):
        request = asked(harness, type(message))
        if request is not None:
            harness.reply(request, message)
    elif isinstance(message, Request):
        harness.call(message, topic=topic_of_service(one.topic) or "")
    elif message is not None:
        harness.send(message, topic=one.topic, sender=one.sender)


def asked(harness: ModuleHarness[Any], reply_type: type[Message]) -> Any:
    """Return the newest request of the module that such a reply answers; None: there is none."""
    name = reply_type.type_name.removesuffix("_Response") + "_Request"
    found = [one.message for one in harness.published if one.message.type_name == name]
    return found[-1] if found else None


def write_test(capsule: Capsule, workspace: Path, path: Path, limit_s: float) -> int:
    """Write the test, and return the exit code."""
    if path.exists():
        print(f"{path} exists already; name another file")
        return 1
    wanted = reported_crash(capsule.report)
    state = base_state(capsule)
    settings = relocated(capsule.manifest.start.settings, capsule.manifest.start.workspace, workspace)
    load_capsule_class(capsule, workspace)  # so that its message types are known
    scene = Scene(capsule, workspace, min(limit_s, 2.0), settings, state)
    acts = whole = acts_of(capsule)
    for scene.seeded in (False, True):
        shorter = _shortened(scene, whole, wanted)
        if shorter is not None:
            acts = shorter
            break
    else:
        print(
            "no test was written: without the times and answers of then, the module does not crash alike "
            f"each time ({scene.crash(whole)}); use --pdb, or give the capsule itself to a colleague"
        )
        return 1
    text = source(scene, acts, wanted)
    compile(text, str(path), "exec")
    _make_folder(path.parent)
    write_private(path, text)
    kept, count = (sum(one.message is not None for one in some) for some in (acts, whole))
    print(
        f"{path}: {kept} of {count} messages are left, after {scene.attempts} attempts; "
        f"it crashes with {wanted}"
    )
    print(f"run it, with unittest or pytest: python3 -m unittest {shlex.quote(str(path))}")
    return 0


def _make_folder(folder: Path) -> None:
    """Make the folder for the test, as a package: `python3 -m unittest` looks into no other."""
    if not folder.exists():
        folder.mkdir(parents=True)
        (folder / "__init__.py").touch()


def _shortened(scene: Scene, acts: Sequence[Act], wanted: Crash) -> list[Act] | None:
    """Return as few and simple lines as crash alike; None: they do not, or only by chance."""
    is_wanted = _crashes_like(scene, wanted)
    if not is_wanted(acts):
        return None
    settings, restored = dict(scene.settings), scene.restored
    shorter = simplified(smallest(list(acts), is_wanted), is_wanted)
    _simplify_scene(scene, shorter, is_wanted)
    if all(scene.crash(shorter).is_like(wanted) for _ in range(SURE)):
        return shorter
    scene.settings, scene.restored, scene.attempts = settings, restored, 0
    return None


def _crashes_like(scene: Scene, wanted: Crash) -> Callable[[Sequence[Act]], bool]:
    def is_wanted(acts: Sequence[Act]) -> bool:
        return scene.attempts < MOST_ATTEMPTS and scene.crash(acts).is_like(wanted)

    return is_wanted


def acts_of(capsule: Capsule) -> list[Act]:
    """Return the lines of a test with everything that the module got."""
    acts: list[Act] = []
    manifest = capsule.manifest
    now_ns = (manifest.is_whole and manifest.start.monotonic_ns) or None
    for step in capsule.steps:
        if step.event is None or step.kind is Event.TEARDOWN:
            continue
        time_ns = step.event.time_ns or now_ns
        passed_s = 0.0 if now_ns is None or time_ns is None else max(0, time_ns - now_ns) / 1e9
        now_ns = time_ns
        acts.append(Act(passed_s, _message_of(step), step.channel.topic if step.channel else "", step.sender))
    return acts


def _message_of(step: Step) -> Message | None:
    if step.kind is not Event.MESSAGE or step.channel is None or step.data is None:
        return None
    message_type = _class_of(step.channel.type_name)
    return None if message_type is None else message_type.decode(step.data)


def _class_of(type_name: str) -> type[Message] | None:
    from robbie_mp.messages.descriptions import own_classes  # noqa: PLC0415

    known = {one.type_name: one for one in [*stock_registry(), *own_classes()]}
    return known.get(type_name)


def smallest(acts: list[Act], is_wanted: Callable[[Sequence[Act]], bool]) -> list[Act]:
    """Return as few of the lines as still crash (delta debugging: Zeller, Hildebrandt, 2002)."""
    last = acts[-1:]
    if is_wanted(last):
        acts = last
    parts = 2
    while len(acts) > 1:
        size = -(-len(acts) // parts)
        for begin in range(0, len(acts), size):
            rest = _without(acts, begin, begin + size)
            if is_wanted(rest):
                acts, parts = rest, max(2, parts - 1)
                break
        else:
            if size == 1:
                break
            parts = min(len(acts), 2 * parts)
    return acts


def _without(acts: list[Act], begin: int, end: int) -> list[Act]:
    """Leave out some lines; their time still passes."""
    passed_s = sum(one.time_s for one in acts[begin:end])
    rest = acts[end:]
    if rest:
        rest = [replaced(rest[0], time_s=rest[0].time_s + passed_s), *rest[1:]]
    return [*acts[:begin], *rest]


def simplified(acts: list[Act], is_wanted: Callable[[Sequence[Act]], bool]) -> list[Act]:
    """Return simpler lines that still crash: no time, no topic, no sender, default values in messages."""
    for number, one in enumerate(acts):
        for simpler in _simpler(one):
            found = replaced(acts[number], **simpler)
            tried = [*acts[:number], found, *acts[number + 1 :]]
            if found != acts[number] and is_wanted(tried):
                acts = tried
                if found.time_s == 0:
                    break
        if acts[number].message is not None:
            acts = _simplified_fields(acts, number, is_wanted)
    return acts


def _simpler(one: Act) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = [{"sender": "test"}, {"time_s": 0.0}]
    return found + ([{"time_s": float(f"{one.time_s:.2g}")}] if one.time_s else [])


def _simplified_fields(acts: list[Act], number: int, is_wanted: Callable[[Sequence[Act]], bool]) -> list[Act]:
    message = acts[number].message
    assert message is not None
    for field in fields_of(type(message)):
        if field.name == "call":
            continue
        for value in _simpler_values(message, field.name):
            try:
                simpler = replace(message, **{field.name: value})
            except (TypeError, ValueError):
                continue
            tried = [*acts[:number], replaced(acts[number], message=simpler), *acts[number + 1 :]]
            if is_wanted(tried):
                acts, message = tried, simpler
                break
    return acts


def _simpler_values(message: Message, name: str) -> list[Any]:
    value = getattr(message, name)
    if isinstance(value, Message):
        try:
            return [type(value)()]
        except (TypeError, ValueError):
            return []
    if isinstance(value, np.ndarray):
        short = [value[:0], value[:1]] if value.ndim == 1 and len(value) > 1 else []
        return [*short, np.zeros_like(value)]
    if isinstance(value, bool) or value in (0, 0.0, ""):
        return []
    return [type(value)()] if isinstance(value, int | float | str) else []


def _simplify_scene(scene: Scene, acts: list[Act], is_wanted: Callable[[Sequence[Act]], bool]) -> None:
    """Leave out settings and the restored state, if it crashes without them."""
    for name in list(scene.settings):
        before = dict(scene.settings)
        del scene.settings[name]
        if not is_wanted(acts):
            scene.settings = before
    if scene.restored is not None:
        before, scene.restored = scene.restored, None
        if not is_wanted(acts):
            scene.restored = before


# -- the text ---------------------------------------------------------------------------------------------


class Imports:
    """The names that a test imports."""

    def __init__(self) -> None:
        self._names: dict[str, set[str]] = {}
        self.numpy = False

    def add(self, one: Any) -> str:
        """Import a class or function, and return its name."""
        module = "robbie_mp.messages" if one in set(stock_registry()) else one.__module__
        name: str = one.__name__
        self._names.setdefault(module, set()).add(name)
        return name

    def lines(self) -> list[str]:
        """Return the lines that import them."""
        ours = [
            f"from {module} import {', '.join(sorted(names))}"
            for module, names in sorted(self._names.items())
        ]
        return [*(["import numpy as np", ""] if self.numpy else []), *ours]


def source(scene: Scene, acts: Sequence[Act], wanted: Crash) -> str:
    """Return the text of the test."""
    start, imports = scene.capsule.manifest.start, Imports()
    module_class = load_capsule_class(scene.capsule, scene.workspace)
    imports.add(ModuleHarness)
    arguments = [imports.add(module_class)]
    if scene.settings:
        arguments.append(_plain(scene.settings, imports))
    more = {
        "name": start.module,
        "topics": start.topics,
        "namespace": start.namespace,
        "restored": scene.restored,
    }
    needed = any(isinstance(one.message, SettingChange | Reply) for one in acts)
    for name, value in more.items():
        if (name != "name" or needed) and (value or (name == "restored" and value is not None)):
            arguments.append(f"{name}={_plain(value, imports)}")
    body = [line for one in acts for line in _act_lines(one, imports)]
    limit, guard = _guards(start, wanted, imports)
    seed = []
    if scene.seeded:
        seed = [f"random.seed({start.seed})", f"np.random.seed({start.seed})"]
        imports.numpy = True
    standard = ["faulthandler"] * bool(guard) + ["random"] * scene.seeded + ["unittest"]
    name = re.sub(r"\W+", "_", f"does_not_crash_with_{_snake(wanted.what or wanted.kind)}".lower())
    report = scene.capsule.report
    test = [
        *seed,
        *guard,
        f"with {limit}ModuleHarness({', '.join(arguments)}) as harness:",
        *(f"    {line}" for line in body or ["pass"]),
    ]
    lines = [
        f'"""What ended {start.module}, from {scene.capsule.path.name}: {report.reason}."""',
        "",
        *(f"import {one}" for one in standard),
        "",
        *imports.lines(),
        "",
        "",
        f"class {_case(start.module)}(unittest.TestCase):",
        f"    def test_{name}(self) -> None:",
        *(f"        {line}" for line in test),
    ]
    return "\n".join(lines) + "\n"


def _case(module: str) -> str:
    """Return a name for the class of the test: both unittest and pytest find its methods."""
    return "".join(word.capitalize() for word in re.split(r"[\W_]+", module)) + "CrashTest"


def _guards(start: StartForm, wanted: Crash, imports: "Imports") -> tuple[str, list[str]]:
    """Return what makes the test end: a limit of memory, and lines that end a hang."""
    if wanted.kind == HANG:
        return "", [f"faulthandler.dump_traceback_later({HANG_S:g}, exit=True)"]
    if wanted.what == "MemoryError" and start.more_bytes is not None:
        return f"{imports.add(limited_address_space)}({start.more_bytes:_}), ", []
    return "", []


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)


def _act_lines(one: Act, imports: Imports) -> list[str]:
    message = one.message
    lines = [f"harness.advance({one.time_s:g})"] if one.time_s or message is None else []
    if isinstance(message, SettingChange):
        return [*lines, f"harness.change_setting({_plain(message.setting, imports)}, {_setting(message)})"]
    if message is None:
        return lines
    text = _message(message, imports)
    if isinstance(message, Reply):
        name = type(message).type_name.removesuffix("_Response") + "_Request"
        request = _class_of(name)
        assert request is not None
        return [
            *lines,
            f"(request,) = harness.take({imports.add(request)})",
            f"harness.reply(request, {text})",
        ]
    if isinstance(message, Request):
        topic = topic_of_service(one.topic)
        return [*lines, f"harness.call({text}{f', topic={_plain(topic, imports)}' if topic else ''})"]
    more = f", topic={_plain(one.topic, imports)}" if one.topic else ""
    more += f", sender={_plain(one.sender, imports)}" if one.sender != "test" else ""
    return [*lines, f"harness.send({text}{more})"]


def _setting(message: SettingChange) -> str:
    import yaml  # noqa: PLC0415

    return _plain(yaml.safe_load(message.value), Imports())


def _message(message: Message, imports: Imports) -> str:
    """Return a message as an author writes it: only the fields that are not at their defaults."""
    kind = type(message)
    is_numbered = isinstance(message, Request | Reply | Goal)
    fields = []
    for field in fields_of(kind):
        value = getattr(message, field.name)
        if not (is_numbered and field.name == "call") and not _is_default(kind, field.name, value):
            fields.append(f"{field.name}={_plain(value, imports)}")
    return f"{imports.add(kind)}({', '.join(fields)})"


def _is_default(kind: type[Message], name: str, value: Any) -> bool:
    try:
        default = getattr(kind(), name)
    except (TypeError, ValueError):
        return False
    if isinstance(value, Message):
        return isinstance(default, Message) and value.encode() == default.encode()
    return bool(np.array_equal(value, default))


def _plain(value: Any, imports: Imports) -> str:
    if isinstance(value, Message):
        return _message(value, imports)
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{_plain(key, imports)}: {_plain(one, imports)}" for key, one in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        inside = ", ".join(_plain(one, imports) for one in value)
        return f"[{inside}]" if isinstance(value, list) else f"({inside}{',' * (len(value) == 1)})"
    if isinstance(value, np.ndarray):
        imports.numpy = True
        return _array(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return numbers(value.item() if isinstance(value, np.generic) else value)


def numbers(value: Any) -> str:
    """Return a number, or a list of numbers, as Python code: `nan` has no name."""
    return _NOT_FINITE.sub(r'float("\g<0>")', repr(value))


def _array(value: "np.ndarray[Any, Any]") -> str:
    if value.size <= SHOWN_ITEMS:
        return f"np.array({numbers(value.tolist())}, np.{value.dtype})"
    for item, name in ((0, "zeros"), (1, "ones")):
        if (value == item).all():
            return f"np.{name}({value.shape!r}, np.{value.dtype})"
    return (
        f"np.frombuffer(bytes.fromhex({value.tobytes().hex()!r}), np.{value.dtype}).reshape({value.shape!r})"
    )
