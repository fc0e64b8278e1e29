"""Reads the settings of a run's modules, and asks modules to change them."""

import secrets
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any, NamedTuple

from robbie_mp.attached.tool.tool import Received, Tool
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.bus.observe import RunObserver
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.setting_changes import NotChangeable, SettingsFile
from robbie_mp.module.settings import SettingError
from robbie_mp.run.control import RunNotControlled
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.show import inline
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.run.supervisor.states import ChildState, state_name

OPEN_TIMEOUT_S = 2.0
ANSWER_TIMEOUT_S = 5.0
Entry = dict[str, Any]
"""A setting as in a SettingsFile: value, type, outline, description, changeable, changed."""


class ChangeAnswer(NamedTuple):
    """What became of a change."""

    value: str
    """The new value as text."""
    waits: str = ""
    """The state of the module, which does not run and takes the change at its next start; '': it has."""


class NoAnswer(RobbieError, TimeoutError):
    """A module has not answered in time whether it has changed a setting."""


class Parameters(Mapping[str, Any]):
    """The settings of a run's modules, by `MODULE.SETTING`.

        run.parameters["mapping.resolution_m"]
        run.parameters.set("mapping.resolution_m", 0.1)

    Values are those that the modules use now. A module's settings are known once it has started.

    Raises:
        RunNotControlled: the run is still starting, or has ended.
    """

    def __init__(self, run: KnownRun):
        self._run = run
        try:
            plan = RunPlan.load(run.folder)
        except FileNotFoundError as error:
            raise RunNotControlled(f"run {run.run_id} is still starting, or has ended") from error
        self._modules = [module.name for module in plan.modules]

    def __getitem__(self, path: str) -> Any:
        """Return the value of a setting.

        Raises:
            NotChangeable: there is no such module or setting.
        """
        return self.find(path)[2]["value"]

    def __iter__(self) -> Iterator[str]:
        """Yield the names of all settings."""
        return (f"{module}.{name}" for module in self._modules for name in self.of_module(module))

    def __len__(self) -> int:
        """Return the number of settings."""
        return sum(1 for _ in self)

    def __contains__(self, path: object) -> bool:
        """Whether there is a setting of this name."""
        return any(path == known for known in self)

    @property
    def modules(self) -> list[str]:
        """The names of the modules, in the order in which they start."""
        return list(self._modules)

    def of_module(self, module: str) -> dict[str, Entry]:
        """Return the settings of a module, with type, description, value, and whether they can be changed.

        Raises:
            NotChangeable: no module has this name.
        """
        if module not in self._modules:
            near = did_you_mean(module, self._modules) or f"; there are {', '.join(self._modules)}"
            raise NotChangeable(f"no module is named {module!r}{near}")
        return SettingsFile(self._run.folder, module).read()

    def find(self, path: str) -> tuple[str, str, Entry]:
        """Return the module, the setting's name, and the setting.

        Raises:
            NotChangeable: there is no such module or setting.
        """
        module, dot, name = path.partition(".")
        if not dot:
            raise NotChangeable(f"expected MODULE.SETTING; got {path!r}")
        settings = self.of_module(module)
        if name not in settings:
            near = did_you_mean(name, settings) or f"; it has {', '.join(settings) or 'none'}"
            raise NotChangeable(f"{module} has no setting {name!r}{near}")
        return module, name, settings[name]

    def find_changeable(self, path: str) -> tuple[str, str, Entry]:
        """Return the same as `find`, for a setting that can be changed.

        Raises:
            NotChangeable: there is no such module or setting, or it cannot be changed.
        """
        module, name, entry = self.find(path)
        if not entry["changeable"]:
            raise NotChangeable(
                f"{module} has no setting {name!r} that can be changed while it runs; set it in the profile, "
                "or declare it with changeable=True"
            )
        return module, name, entry

    def set(self, path: str, value: object, timeout_s: float = ANSWER_TIMEOUT_S) -> str:
        """Ask a module to change a setting, and wait for its answer.

        A module that does not run takes the change at its next start, and nothing is awaited.

        Args:
            path: the setting.
            value: the new value, as a profile would hold it.
            timeout_s: time to wait for the answer.

        Returns:
            The new value as text.

        Raises:
            NotChangeable: there is no such module or setting, or it cannot be changed.
            SettingError: the module refuses the value.
            NoAnswer: the module has not answered in time. It may still make the change.
            ControlRefused: the profile allows no further tools.
            RunEnded, RunNotControlled: the run has ended, or is just starting.
        """
        return self.set_text(path, inline(value), timeout_s).value

    def set_text(self, path: str, text: str, timeout_s: float = ANSWER_TIMEOUT_S) -> ChangeAnswer:
        """Do the same as `set`, with the value in YAML; the answer also says whether the change waits."""
        module, name, _ = self.find_changeable(path)
        file = SettingsFile(self._run.folder, module)
        if not self._is_running(module):
            file.wait_for_start(name, text)
            if not self._is_running(module) or not file.withdraw(name):
                return ChangeAnswer(text, self._state(module))
        return ChangeAnswer(self._ask(module, name, path, text, timeout_s))

    def _ask(self, module: str, name: str, path: str, text: str, timeout_s: float) -> str:
        with closing(Tool(self._run, f"robbie param set {path}")) as tool:
            tool.subscribe(SettingChanged.type_name, SettingChanged.version, module)
            tool.ready()
            tool.wait_for(tool.is_subscribed, OPEN_TIMEOUT_S)
            request = secrets.randbits(63)
            tool.publish(SettingChange(request=request, setting=name, value=text), module)
            answers = _answers(tool, request)
            if not tool.wait_for(lambda: next(answers) is not None, timeout_s):
                raise NoAnswer(
                    f"no answer within {timeout_s:g} s; {module} is {self._state(module)}, and will "
                    "make the change once it handles the request"
                )
            answer = next(answers)
        assert answer is not None
        if answer.error:
            raise SettingError(f"{module} refuses: {answer.error}", name)
        return answer.value

    def _is_running(self, module: str) -> bool:
        return self._state(module) == ChildState.RUNNING

    def _state(self, module: str) -> str:
        with closing(RunObserver(self._run.run_id)) as observer:
            found = (figures.state for figures in observer.modules() if figures.name == module)
            return state_name(next(found))


def _answers(tool: Tool, request: int) -> Iterator[SettingChanged | None]:
    """Yield None until the answer to a request has arrived, and from then on the answer."""
    answer: SettingChanged | None = None
    while True:
        received: Received | None = tool.take() if answer is None else None
        if received is not None:
            said = SettingChanged.decode(received.data)
            answer = said if said.request == request else None
        yield answer
