"""The examples of docs/messages.md do what it says."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

import robbie_mp.messages as package
from robbie_mp.messages import (
    DecodeError,
    Header,
    IllFormed,
    LaserScan,
    check_well_formed,
    decode_version,
    message_type_from_schema,
)
from robbie_mp.messages.flaws import beyond

PAGE = (Path(__file__).parents[2] / "docs" / "messages.md").read_text()
DECLARE, RULE, LOAN, VERSIONS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def run(example: str, **names: object) -> dict[str, Any]:
    namespace = {name: getattr(package, name) for name in package.__all__} | names
    exec(example, namespace)
    return namespace


def test_the_declaration() -> None:
    names = run(DECLARE, __name__=__name__)
    victim = names["victim"]
    assert (victim.state, len(victim.covariance), len(victim.corners)) == (0, 9, 4)
    assert names["Victim"].decode(victim.encode()) == victim


def test_the_rule() -> None:
    wrench = run(RULE, __name__=__name__, beyond=beyond)["Wrench"]
    check_well_formed(wrench(torque_nm=-20.0))
    with pytest.raises(IllFormed, match="torque_nm is nan"):
        check_well_formed(wrench(torque_nm=math.nan))


def test_the_loan() -> None:
    class Camera:
        def read_into(self, data: Any) -> None:
            data[:] = 7

    buffer = memoryview(bytearray(1_000_000))
    names = run(LOAN, header=Header(), camera=Camera(), buffer=buffer)
    assert package.Image.decode(buffer[: names["layout"].size]) == names["image"]
    assert set(names["image"].data[[0, -1]]) == {7}


def test_the_upgrade() -> None:
    charge = run(VERSIONS, __name__=__name__)["Charge"]
    old = message_type_from_schema(charge.type_name, "float32 percent")
    assert decode_version(charge, old(percent=50.0).encode(), 1).ratio == 0.5


def test_the_error() -> None:
    with pytest.raises(DecodeError) as caught:
        LaserScan.decode(LaserScan(ranges=range(360)).encode()[:152])  # type: ignore[arg-type]
    assert f"`{caught.value}`" in PAGE
