"""The panels, by the names with which profiles arrange them."""

from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.cameras import CamerasPanel
from robbie_mp.station.panels.devices import DevicesPanel
from robbie_mp.station.panels.drive import DrivePanel
from robbie_mp.station.panels.map import MapPanel
from robbie_mp.station.panels.messages import MessagesPanel
from robbie_mp.station.panels.mission import MissionPanel
from robbie_mp.station.panels.parameters import ParametersPanel
from robbie_mp.station.panels.plots import PlotsPanel
from robbie_mp.station.panels.speech import SpeechPanel
from robbie_mp.station.panels.system import SystemPanel
from robbie_mp.station.panels.trace import TracePanel
from robbie_mp.station.panels.view import ViewPanel

PANELS: dict[str, type[Panel]] = {
    panel.name: panel
    for panel in (
        DrivePanel,
        ViewPanel,
        MapPanel,
        CamerasPanel,
        MissionPanel,
        SpeechPanel,
        SystemPanel,
        ParametersPanel,
        DevicesPanel,
        PlotsPanel,
        TracePanel,
        MessagesPanel,
    )
}
