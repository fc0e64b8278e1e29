"""The strip at the top of the page names the modules that are FAILED or DEGRADED."""

from robbie_mp.run.supervisor.states import STATES, ChildState
from robbie_mp.station.page.state_item import ALERT, GOOD, WARNING
from robbie_mp.station.page.state_strip import health_item
from tests.cli._support.readings import laser, mapping


def test_strip_tells_trouble_of_modules_and_why() -> None:
    well, ill = laser(0.0), laser(0.0, health="it is unplugged")
    failed = mapping(0.0, state=STATES.index(ChildState.FAILED) + 1)
    quiet = health_item([well], 2)
    assert (quiet.text, quiet.look) == ("2 restarts", GOOD)
    degraded = health_item([ill], 2)
    assert (degraded.text, degraded.look) == ("laser DEGRADED", WARNING)
    assert degraded.detail == "laser: it is unplugged"
    assert (health_item([ill, failed], 2).text, health_item([ill, failed], 2).look) == (
        "mapping FAILED",
        ALERT,
    )
