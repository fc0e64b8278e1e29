"""The simulated battery conserves energy and charge."""

import pytest

from robbie_robots.hw.battery import BatteryReading
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.pose import ORIGIN
from robbie_robots.hw.simulation.battery import BatteryModel, SimulatedBattery

LOSSLESS = BatteryModel(resistance_ohm=1e-9)


def drained(
    battery: SimulatedBattery, seconds: float, linear: float = 0.0, angular: float = 0.0, step_s: float = 1.0
) -> list[BatteryReading]:
    readings = []
    for n in range(round(seconds / step_s) + 1):
        battery.drain(DriveState(n * step_s, ORIGIN, linear, angular))
        readings.append(battery.read())
    return readings


@pytest.mark.parametrize(("linear", "angular"), [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.3, -1.0)])
def test_delivered_energy_is_power_times_time(linear: float, angular: float) -> None:
    model = BatteryModel()
    readings = drained(SimulatedBattery(model), 600.0, linear, angular)
    given_ws = sum(reading.voltage_v * reading.current_a for reading in readings[1:])
    power_w = 20.0 + 30.0 * abs(linear) + 6.0 * abs(angular)
    assert given_ws == pytest.approx(power_w * 600.0, rel=0.002)


def test_drained_charge_is_current_times_time() -> None:
    readings = drained(SimulatedBattery(), 600.0, 0.5)
    lost_ah = readings[0].charge_ah - readings[-1].charge_ah
    assert lost_ah == pytest.approx(sum(reading.current_a for reading in readings[1:]) / 3600)


def test_resistance_costs_voltage_and_energy() -> None:
    real, lossless = BatteryModel(resistance_ohm=0.5), LOSSLESS
    first, second = (drained(SimulatedBattery(model), 600.0, 0.5)[-1] for model in (real, lossless))
    assert first.voltage_v == pytest.approx(real.open_circuit_v(first.charge_ah) - 0.5 * first.current_a)
    assert first.charge_ah < second.charge_ah


def test_full_and_empty_cells_have_the_right_voltages() -> None:
    model = BatteryModel(cells=3)
    assert model.open_circuit_v(model.capacity_ah) == pytest.approx(12.6)
    assert model.open_circuit_v(0.0) == pytest.approx(9.0)


def test_battery_is_empty_when_its_energy_is_used_up() -> None:
    # Full to empty at a constant current: capacity x mean voltage of the curve / 20 W.
    battery = SimulatedBattery(BatteryModel(capacity_ah=0.1, resistance_ohm=1e-9))
    readings = drained(battery, 400.0)
    empty = next(n for n, reading in enumerate(readings) if reading.charge_ah == 0.0)
    mean_v = 4 * (0.05 * 3.175 + 0.05 * 3.425 + 0.1 * 3.55 + 0.3 * 3.675 + 0.3 * 3.865 + 0.2 * 4.09)
    assert empty == pytest.approx(0.1 * mean_v * 3600 / 20.0, abs=2)
    assert readings[-1].current_a == 0.0


def test_first_call_and_calls_without_elapsed_time_drain_nothing() -> None:
    battery = SimulatedBattery(charge_ah=2.0)
    for _ in range(3):
        battery.drain(DriveState(1e9, ORIGIN, 0.5, 0.0))
    assert battery.read().charge_ah == 2.0


def test_battery_that_cannot_deliver_the_power_delivers_its_maximum() -> None:
    weak = BatteryModel(resistance_ohm=5.0)
    reading = drained(SimulatedBattery(weak), 1.0, 0.8)[0]
    assert reading.current_a == pytest.approx(weak.open_circuit_v(5.0) / 10.0)
