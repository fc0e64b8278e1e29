"""An observer sees everything and steers nothing except the emergency stop, whatever events are sent."""

import time
import uuid
from dataclasses import replace

import pytest

from robbie_mp.station.panel_classes import FRAMEWORK_PANELS
from tests.security.station._support.attacker import Document, PageSocket, listener_of, listeners
from tests.security.station.conftest import Station

pytestmark = pytest.mark.timeout(300)
DRIVE = {"held": True, "begins": True, "linear": 1.0, "angular": 0.0, "sent_s": 1.0}
PLACE = {"what": "goal", "x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.0}
CRAFTED: list[object] = [None, True, 1, "goal", DRIVE, PLACE, {"value": 1, "label": "¼"}, ["error"]]
"""What events carry, and more."""


def press(page: PageSocket, document: Document, name: str, event: str, *arguments: object) -> None:
    element, listener = listener_of(document.elements, event, id=name)
    page.fire(document.client_id, element, listener, *arguments)


def drive(station: Station, page: PageSocket, document: Document) -> None:
    """Drive, as soon as the station knows the delay of the page."""

    def has_driven(_: object) -> bool:
        page.listen(0.3)
        page.answer_delay_pings(document)
        press(page, document, "driver", "drive", DRIVE | {"sent_s": time.monotonic()})
        return ("DriveCommand", None) in station.heard

    station.robot.until(has_driven)


def test_no_event_of_an_observers_page_steers_the_robot(station: Station) -> None:
    observer = station.observer()
    document = observer.open()
    states = {name: (one["state"], one["incarnation"]) for name, one in station.robot.top().items()}
    with observer.connect(document.query) as page:
        for name in (*FRAMEWORK_PANELS, "mission"):
            press(page, document, f"tab-{name}", "click")
            page.listen(0.7)  # what a panel shows first comes with its first update
        elements = document.elements | page.elements
        found = listeners(elements)
        assert len(found) > 30, "the page has hardly anything that could be pressed; was it found at all?"
        for element, _, listener in found:
            for arguments in ([], *([one] for one in CRAFTED)):
                page.fire(document.client_id, element, listener, *arguments)
        page.listen(0.1)
        observer.stop_robot()
    assert set(station.heard) == {("EmergencyStop", True)}
    now = {name: (one["state"], one["incarnation"]) for name, one in station.robot.top().items()}
    assert now == states


def test_observer_cannot_release_the_emergency_stop(station: Station) -> None:
    observer = station.observer()
    document = observer.open()
    with observer.connect(document.query) as page:
        observer.stop_robot()
        for key, _, listener in listeners(document.elements):
            if document.elements[key]["props"].get("id") == "confirm-release":
                page.fire(document.client_id, key, listener)
        page.listen(0.3)
        observer.stop_robot()  # after which the robot would have heard of a release
    assert set(station.heard) == {("EmergencyStop", True)}
    assert station.robot.top()["base"]["status"].startswith("STOPPED")


def test_operator_can_do_what_an_observer_cannot(station: Station) -> None:
    """The refusals in the other tests mean something only if the same events work for an operator."""
    operator = station.operator()
    document = operator.open()
    with operator.connect(document.query) as page:
        press(page, document, "confirm-release", "click")
        station.robot.until(lambda _: ("EmergencyStop", False) in station.heard)
        drive(station, page, document)
        press(page, document, "map-view", "placed", PLACE)
        station.robot.until(lambda _: ("robbie_msgs/action/NavigateTo_Goal", None) in station.heard)


@pytest.mark.parametrize("has_handshake", [False, True], ids=["its own socket", "another handshake"])
@pytest.mark.parametrize("names_client", [False, True], ids=["no client named", "client named"])
def test_events_in_the_name_of_another_page_are_refused(
    station: Station, has_handshake: bool, names_client: bool
) -> None:
    operator, observer = station.operator(), station.observer()
    driven, own = operator.open(), observer.open()
    with operator.connect(driven.query):
        query = own.query if not has_handshake else driven.query
        if not names_client:
            query = {}
        with observer.connect(query) as page:
            if has_handshake:
                page.emit("handshake", driven.query | {"document_id": str(uuid.uuid4())})
            for name, event, arguments in (
                ("confirm-release", "click", []),
                ("driver", "drive", [DRIVE]),
                ("mark", "click", []),
            ):
                press(page, driven, name, event, *arguments)
                response = {"client_id": driven.client_id, "request_id": "", "result": 0}
                page.emit("javascript_response", response)
            page.listen(0.3)
        observer.stop_robot()
    assert set(station.heard) == {("EmergencyStop", True)}


def test_sockets_of_two_operators_cannot_send_events_for_each_others_pages(station: Station) -> None:
    first, second = station.operator(), station.operator()
    theirs, own = first.open(), second.open()
    with first.connect(theirs.query), second.connect(own.query) as page:
        press(page, theirs, "confirm-release", "click")
        page.listen(0.3)
        second.stop_robot()
    assert set(station.heard) == {("EmergencyStop", True)}


def test_page_unknown_to_a_restarted_station_is_reloaded(station: Station) -> None:
    operator = station.operator()
    query = operator.open().query | {"client_id": str(uuid.uuid4())}
    with operator.connect(query) as page:
        assert page.greeting == '44{"message":"Implicit handshake failed"}'


def test_session_of_a_replaced_token_gets_no_connection(station: Station) -> None:
    document = station.operator().open()
    with pytest.raises(Exception, match="403"):  # noqa: SIM117
        with replace(station.stranger(), cookie=f"robbie_session_{station.port}=guessed").connect(
            document.query
        ):
            pass
