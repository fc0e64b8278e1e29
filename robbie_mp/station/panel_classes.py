"""The panels that a page can show: the framework's own, and those that the profile names.

Only `load_panels` imports them, because the module must run without the extra `gui`, which they need.
"""

from collections.abc import Iterable, Mapping

from robbie_mp.module.settings import SettingError
from robbie_mp.run.profile.check import NotAModule, load_class
from robbie_mp.station.panel import Panel

FRAMEWORK_PANELS = {
    "drive": "robbie_mp.station.panels.drive:DrivePanel",
    "view": "robbie_mp.station.panels.view:ViewPanel",
    "map": "robbie_mp.station.panels.map:MapPanel",
    "camera": "robbie_mp.station.panels.camera:CameraPanel",
    "cameras": "robbie_mp.station.panels.cameras:CamerasPanel",
    "robots": "robbie_mp.station.panels.robots:RobotsPanel",
    "joints": "robbie_mp.station.panels.joints:JointsPanel",
    "speech": "robbie_mp.station.panels.speech:SpeechPanel",
    "system": "robbie_mp.station.panels.system:SystemPanel",
    "parameters": "robbie_mp.station.panels.parameters:ParametersPanel",
    "devices": "robbie_mp.station.panels.devices:DevicesPanel",
    "plots": "robbie_mp.station.panels.plots:PlotsPanel",
    "happened": "robbie_mp.station.panels.happened:HappenedPanel",
    "timeline": "robbie_mp.station.panels.time_line:TimeLinePanel",
    "trace": "robbie_mp.station.panels.trace:TracePanel",
    "messages": "robbie_mp.station.panels.messages:MessagesPanel",
}
"""Classes by the names that profiles use."""
OWN_PANELS_AFTER = "cameras"
"""The tabs of the robot's own panels are between those for operators and those for engineers."""
SETTING = "panels"


def panels_in_order(own: Mapping[str, type[Panel]]) -> dict[str, type[Panel]]:
    """Import the framework's panels; return these and the robot's own, in the order of their tabs.

    Raises:
        ModuleNotFoundError: the extra `gui` is not installed.
    """
    ordered: dict[str, type[Panel]] = {}
    for name, class_path in FRAMEWORK_PANELS.items():
        ordered[name] = _load(class_path)
        if name == OWN_PANELS_AFTER:
            ordered |= own
    return ordered


def load_panels(class_paths: Iterable[str]) -> dict[str, type[Panel]]:
    """Import the panels that a profile names.

    Args:
        class_paths: each `package.module:Class`.

    Returns:
        The classes by the names of the panels.

    Raises:
        SettingError: a path is malformed, the class does not exist or is not a panel, or its name is taken.
        ModuleNotFoundError: a library that a panel imports is not installed.
        Exception: any error of the imported code.
    """
    found: dict[str, type[Panel]] = {}
    for class_path in class_paths:
        module_name, _, class_name = class_path.partition(":")
        if not module_name or not class_name:
            raise SettingError(f"expected package.module:Class; got {class_path!r:.60}", SETTING)
        try:
            panel = _load(class_path)
        except NotAModule as error:
            raise SettingError(str(error), SETTING) from None
        for attribute in ("name", "title", "icon"):
            if not isinstance(getattr(panel, attribute, None), str):
                raise SettingError(f"{class_path} has no {attribute}; expected a text", SETTING)
        if panel.name in FRAMEWORK_PANELS or panel.name in found:
            taken_by = (
                FRAMEWORK_PANELS.get(panel.name)
                or f"{found[panel.name].__module__}:{found[panel.name].__name__}"
            )
            raise SettingError(f"{class_path}: {taken_by} is called {panel.name!r} already", SETTING)
        found[panel.name] = panel
    return found


def _load(class_path: str) -> type[Panel]:
    return load_class(class_path, Panel)  # type: ignore[type-abstract]  # the class that is found is concrete
