"""The robot's lights."""

import numpy as np

from robbie_mp import CallRefused, Header, Module, SettingError, Time, setting
from robbie_mp.messages import LightSet, LightsState, SetLight
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.lctech.relay_protocol import MAX_RELAYS, RelayAnswer
from robbie_robots.hw.lctech.relays import RelayLights
from robbie_robots.hw.lights import Lights, LightsError
from robbie_robots.hw.simulation.lights import SimulatedLights
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule

STATE_PERIOD_S = 0.5


class SwitchedLights(Module):
    """A module whose lights people and modules switch with `SetLight`; all are dark at its start and end.

    Serves `SetLight`, and publishes `LightsState` at each change and twice a second, both on a topic named
    after the module.
    """

    switched: Lights

    lights: list[str] = setting(["headlight"], "names of the lights")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Raise SettingError if the names do not fit."""
        names = settings["lights"]
        assert isinstance(names, list)
        if not names or len(set(names)) < len(names):
            raise SettingError("expected at least one light, each with a name that no other has", "lights")

    def obey(self) -> None:
        """Serve the requests."""
        self._lights_told_ns = -(10**18)
        self.serve(SetLight, self.on_set, topic=self.name)

    def on_set(self, request: SetLight) -> LightSet:
        """Switch a light, or refuse."""
        try:
            brightness = self.switched.shine(request.name, request.brightness)
        except (LightsError, DeviceSilent) as error:
            raise CallRefused(str(error)) from error
        self.tell_lights(at_once=True)
        return LightSet(brightness=brightness)

    def tell_lights(self, *, at_once: bool = False) -> None:
        """Publish how bright the lights are if it is time to; nothing while that is not known."""
        now_ns = self.clock.now_ns()
        brightness = self.switched.read()
        if brightness is None or not (at_once or now_ns - self._lights_told_ns >= STATE_PERIOD_S * 1e9):
            return
        self._lights_told_ns = now_ns
        self.publish(
            LightsState(
                header=Header(stamp=Time.from_nanoseconds(now_ns)),
                name=self.lights,
                brightness=np.array(brightness),
                can_dim=self.switched.can_dim,
            ),
            topic=self.name,
        )


class SimulatedLightsModule(SwitchedLights):
    """Simulated lights that can be dimmed: see `SwitchedLights`."""

    period_s: float = setting(0.1, "time between looks whether to tell the state", minimum=0.01)

    def setup(self) -> None:
        """Create the lights."""
        self.switched = SimulatedLights(self.lights)
        self.obey()

    def tick(self) -> None:
        """Publish how bright the lights are."""
        self.tell_lights()
        shown = zip(self.lights, self.switched.read() or (), strict=True)
        self.status = ", ".join(f"{name} {brightness:.0%}" for name, brightness in shown)


class RelayLightsModule(SwitchedLights, PluggableDeviceModule[RelayAnswer]):
    """Lights on a relay board of LC Technology (LCUS-1 to LCUS-8): see `SwitchedLights`.

    The first light is on relay 1. Publishes `DeviceState`, too.
    """

    wait_s = 0.0

    period_s: float = setting(0.02, "time between looks at the board", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Raise SettingError if the names do not fit a board."""
        super().check(settings)
        names = settings["lights"]
        if isinstance(names, list) and len(names) > MAX_RELAYS:
            raise SettingError(f"a board has at most {MAX_RELAYS} relays, not {len(names)}", "lights")

    def setup(self) -> None:
        """Create the driver."""
        super().setup()
        self.obey()

    def open_device(self) -> RelayLights:
        """Return the driver."""
        self.board = self.switched = RelayLights(self.url, self.lights, silence_s=self.silence_s)
        return self.board

    def on_value(self, value: RelayAnswer) -> None:
        """Do nothing: the driver itself compares what the board tells."""

    def tick(self) -> None:
        """Publish how bright the lights are, and the board's state."""
        super().tick()
        self.tell_lights()

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        shining = self.board.read()
        if shining is None:
            return super().status_line()
        lit = [name for name, brightness in zip(self.lights, shining, strict=True) if brightness]
        told = f"{self.board.repeated} commands repeated" if self.board.tells else "the board tells no states"
        return f"{', '.join(lit) or 'all dark'}; {told}, lost {self.board.counters.losses} times"
