"""Base of the modules of pluggable devices: they poll the device and tell its state."""

from typing import Generic, Protocol, TypeVar

from robbie_mp import REQUIRED, Header, Module, Time, setting
from robbie_mp.messages import DeviceState
from robbie_robots.hw.connection.device import ConnectionState, Counters, PluggableDevice
from robbie_robots.modules.devices.offered_port import RUN_PORT, offered_port

# The longest wait for data in one tick: an ordered stop waits for it.
MAX_WAIT_S = 0.1
# The state is told when it changes, and at this interval.
STATE_PERIOD_S = 1.0
# A device that is there may need this long until it is found after the start.
FOUND_WITHIN_S = 3.0

T = TypeVar("T")


class ReconnectingDevice(Protocol[T]):
    """The driver of a device that may be pulled out: `PluggableDevice`, or `BackgroundDevice`."""

    silence_s: float
    reason: str
    counters: Counters

    @property
    def state(self) -> ConnectionState:
        """Return whether the device can be used."""

    @property
    def is_connected(self) -> bool:
        """Return whether the device can be used."""

    def poll(self, wait_s: float = 0.0) -> list[T]:
        """Return what has come since the last call."""

    def close(self) -> None:
        """Switch the device off."""


class ReconnectingDeviceModule(Module, Generic[T]):
    """A module whose device may be pulled out and plugged in at any time.

    While the device is away, the module runs on, publishes nothing of it, and is DEGRADED. It is DEGRADED,
    too, while the device says that something is wrong with it. A subclass opens the driver in `open_device`
    and publishes a measurement in `on_value`. It may override `wait_s` with 0 if it also handles messages.

    Publishes `DeviceState`, on a topic named after the module.
    """

    period_s: float = setting(0.005, "time between looks at the device; a look waits for data", minimum=0.001)

    wait_s = MAX_WAIT_S
    ticks_wait = True

    def setup(self) -> None:
        """Create the driver; it connects in the first tick, or whenever the device is there."""
        self.device = self.open_device()
        self._told = ConnectionState.DISCONNECTED
        self._told_ns = -(10**18)
        self._began_s = self.monotonic_s()

    @property
    def place(self) -> str:
        """Return where the device is, as the profile says."""
        raise NotImplementedError

    @property
    def complaint(self) -> str:
        """Return what the device says is wrong with it, in plain words; '' if nothing."""
        return ""

    def open_device(self) -> ReconnectingDevice[T]:
        """Return the driver."""
        raise NotImplementedError

    def on_value(self, value: T) -> None:
        """Publish a measurement."""
        raise NotImplementedError

    def tick(self) -> None:
        """Publish what the device has measured, and its state."""
        for value in self.device.poll(self.wait_s):
            self.on_value(value)
        self.tell_state()

    def teardown(self) -> None:
        """Switch the device off."""
        self.device.close()

    def tell_state(self) -> None:
        """Publish the device's state if it has changed, or if it is time to."""
        self._tell_health()
        now_ns, state, counters = self.clock.now_ns(), self.device.state, self.device.counters
        if state is self._told and now_ns - self._told_ns < STATE_PERIOD_S * 1e9:
            return
        if state is not self._told and state is ConnectionState.CONNECTED:
            self.log.info("the device at %s is connected", self.place)
        self._told, self._told_ns = state, now_ns
        self.publish(
            DeviceState(
                header=Header(stamp=Time.from_nanoseconds(now_ns)),
                port=self.place,
                state=state.value,
                reason=self.device.reason,
                connections=counters.connections,
                losses=counters.losses,
                damaged=counters.damaged,
            ),
            topic=self.name,
        )
        self.status = self.status_line()

    def _tell_health(self) -> None:
        """Be DEGRADED while the device complains or is away; at the start, if it is not found in time."""
        was_found = self.device.counters.connections > 0
        if self.device.is_connected:
            self.degraded = self.complaint
        elif was_found or self.monotonic_s() - self._began_s > FOUND_WITHIN_S:
            self.degraded = f"the device is disconnected: {self.device.reason}"

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        if not self.device.is_connected:
            return f"DISCONNECTED: {self.device.reason}"
        counters = self.device.counters
        return (
            f"{counters.values} measurements, {counters.damaged} damaged frames, lost {counters.losses} times"
        )

    def time_s(self) -> float:
        """Return the run's time, for the driver's stamps."""
        return self.clock.now_ns() / 1e9


class PluggableDeviceModule(ReconnectingDeviceModule[T]):
    """A module whose device is on a port: see `ReconnectingDeviceModule`."""

    port: str = setting(
        REQUIRED,
        "port: a path, socket://HOST:PORT, rfc2217://HOST:PORT, or run:MODULE for an emulated device",
    )
    silence_s: float = setting(
        1.0, "the device counts as disconnected when it sends nothing valid for this time", minimum=0.05
    )

    @property
    def place(self) -> str:
        """Return the port."""
        return self.port

    @property
    def url(self) -> str:
        """Return the port as drivers take it; a module of this run that emulates the device offers it."""
        if self.port.startswith(RUN_PORT):
            return str(offered_port(self.output_directory, self.port.removeprefix(RUN_PORT)))
        return self.port

    def open_device(self) -> PluggableDevice[T]:
        """Return the driver."""
        raise NotImplementedError
