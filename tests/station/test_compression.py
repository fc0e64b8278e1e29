"""States that repeat what was sent before are small, and few bytes of a page do not become very many."""

import json

import pytest
from wsproto import ConnectionType, WSConnection
from wsproto.events import AcceptConnection, BytesMessage, CloseConnection, Request, TextMessage
from wsproto.extensions import PerMessageDeflate

from robbie_mp.station.web.compression import MAX_MESSAGE_BYTES, PageConnection

STATE = {
    "tag": "hud",
    "props": {"now": {"speed": 0.31, "ring": [1.5, 2.0, 0.4], "camera": "front"}},
    "events": [],
}


def joined(*, is_compressed: bool) -> tuple[WSConnection, PageConnection]:
    """Return a browser's and the station's ends of a connection."""
    browser, station = WSConnection(ConnectionType.CLIENT), PageConnection()
    station.is_compressed = is_compressed
    station.receive_data(browser.send(Request(host="robot", target="/", extensions=[PerMessageDeflate()])))
    assert [type(one) for one in station.events()] == [Request]
    browser.receive_data(station.send(AcceptConnection()))
    assert [type(one) for one in browser.events()] == [AcceptConnection]
    return browser, station


@pytest.mark.parametrize("is_compressed", [True, False])
def test_state_that_changes_a_little_is_small(is_compressed: bool) -> None:
    browser, station = joined(is_compressed=is_compressed)
    for speed in (0.31, 0.32):
        STATE["props"]["now"]["speed"] = speed  # type: ignore[index]
        sent = station.send(TextMessage(data=json.dumps(STATE)))
        browser.receive_data(sent)
        (came,) = browser.events()
        assert isinstance(came, TextMessage)
        assert json.loads(came.data) == STATE
    assert len(sent) < 30 if is_compressed else len(sent) > 100


def test_page_may_compress_what_it_sends() -> None:
    browser, station = joined(is_compressed=True)
    for size in (0, 1, 5000, MAX_MESSAGE_BYTES - 100):
        station.receive_data(browser.send(TextMessage(data="x" * size)))
        assert "".join(one.data for one in station.events() if isinstance(one, TextMessage)) == "x" * size


def test_few_bytes_that_become_very_many_end_the_connection() -> None:
    browser, station = joined(is_compressed=True)
    bomb = browser.send(BytesMessage(data=bytes(50 * MAX_MESSAGE_BYTES)))
    assert len(bomb) < MAX_MESSAGE_BYTES
    station.receive_data(bomb)
    (end,) = station.events()
    assert isinstance(end, CloseConnection)
    assert end.code == 1009
