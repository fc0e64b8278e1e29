"""What pages send is decoded in one place, which lets no number through that Python cannot compute with."""

import pytest

from robbie_mp.station.web.page_json import from_page


@pytest.mark.parametrize(
    "text", ["0", "-3", "0.5", "1e21", "123456789012345678901", '{"x": [null, true, "9"]}']
)
def test_what_pages_send_is_decoded(text: str) -> None:
    assert from_page(text) is not None


@pytest.mark.parametrize(
    "text", ["", "{", 400 * "9", "NaN", "-Infinity", "1e999", "[" * 9000, '{"x": [' + 99 * "9" + "]}"]
)
def test_what_no_page_sends_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_page(text)
