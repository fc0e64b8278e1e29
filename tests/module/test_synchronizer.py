"""A module's handler gets messages of several topics that belong together."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robbie_mp import (
    CannotSynchronize,
    Header,
    Input,
    Message,
    MessageHandling,
    Module,
    ModuleHarness,
    RobbieError,
    Synchronizer,
    Time,
)
from robbie_mp.messages import CameraInfo, Image, LaserScan, Odometry, String
from robbie_mp.module.subscriptions import SubscribedTwice

MS = 1_000_000


def at(ms: float) -> Header:
    return Header(stamp=Time.from_nanoseconds(round(ms * MS)))


def image(ms: float) -> Image:
    return Image(header=at(ms), data=np.frombuffer(b"pixels", np.uint8))


def scan(ms: float) -> LaserScan:
    return LaserScan(header=at(ms))


class Pairs(Module):
    """Pairs images with scans."""

    tolerance_s = 0.01
    handling = MessageHandling.ALWAYS_DELIVER

    def setup(self) -> None:
        self.seen: list[tuple[int, ...]] = []
        self.images: list[Image] = []
        self.pairs = Synchronizer(
            self,
            Input(Image, "camera"),
            LaserScan,
            handler=self.on_pair,
            tolerance_s=self.tolerance_s,
            handling=self.handling,
        )

    def on_pair(self, image: Image, scan: LaserScan) -> None:
        self.seen.append((image.header.stamp.nanoseconds // MS, scan.header.stamp.nanoseconds // MS))
        self.images.append(image)
        self.status = str(self.pairs)


def test_nearest_messages_within_the_tolerance_make_a_pair() -> None:
    with ModuleHarness(Pairs) as harness:
        for ms in (0, 33, 66, 100):
            harness.send(image(ms), topic="camera")
        for ms in (4, 70, 104):
            harness.send(scan(ms), topic="laser")
        assert harness.module.seen == [(0, 4), (66, 70)]
        harness.send(image(133), topic="camera")
        assert harness.module.seen[2:] == [(100, 104)]
        assert harness.module.status == "3 sets; left over: camera 1, LaserScan 0"
        assert bytes(harness.module.images[0].data) == b"pixels"
        assert [count.waiting for count in harness.module.pairs.counts] == [1, 0]
        harness.module.pairs.forget()
        assert [count.forgotten for count in harness.module.pairs.counts] == [1, 0]


class Exact(Module):
    """Brings three messages of the same stamp together."""

    def setup(self) -> None:
        self.seen: list[float] = []
        Synchronizer(
            self, Input(Image, "camera"), Input(CameraInfo, "camera"), Odometry, handler=self.on_three
        )

    def on_three(self, image: Image, info: CameraInfo, odometry: Odometry) -> None:
        self.seen.append(image.header.stamp.nanoseconds / MS)
        assert image.header == info.header == odometry.header


def test_without_a_tolerance_stamps_are_the_same() -> None:
    with ModuleHarness(Exact) as harness:
        for ms in (1.0, 2.0, 3.0):
            harness.send(image(ms), topic="camera")
            harness.send(Odometry(header=at(ms)), topic="odom")
        for ms in (1.0, 2.001, 3.0):
            harness.send(CameraInfo(header=at(ms)), topic="camera")
        assert harness.module.seen == [1, 3]


class ByPublication(Module):
    """Pairs texts, which have no stamp, with scans, whose stamps count in milliseconds."""

    def setup(self) -> None:
        self.seen: list[str] = []
        Synchronizer(
            self,
            String,
            Input(LaserScan, stamp_ns=lambda scan: int(scan.angle_min * MS)),
            handler=self.on_pair,
            tolerance_s=0.001,
        )

    def on_pair(self, text: String, scan: LaserScan) -> None:
        self.seen.append(f"{text.data} {scan.angle_min:g}")


def test_stamp_is_the_time_of_publication_or_what_the_author_says() -> None:
    with ModuleHarness(ByPublication) as harness:
        for name in "abc":
            harness.send(String(data=name))
            harness.clock.advance(0.1)
        harness.send(LaserScan(angle_min=100.0))
        harness.send(LaserScan(angle_min=200.0))
        assert harness.module.seen == ["b 100", "c 200"]


def test_newest_only_is_a_matter_of_the_subscriptions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Pairs, "handling", MessageHandling.KEEP_ONLY_NEWEST)
    with ModuleHarness(Pairs) as harness:
        for subscription in harness.bus.subscriptions:
            if subscription.name.type_name in (Image.type_name, LaserScan.type_name):
                assert subscription.handling is MessageHandling.KEEP_ONLY_NEWEST
                assert subscription.handler.__qualname__ == "Pairs.on_pair", "crash reports name it"


@pytest.mark.parametrize(
    ("send", "why"),
    [
        (lambda harness: None, "nothing came from LaserScan"),
        (lambda harness: harness.send(scan(100_000)), "apart; the tolerance is 0.01 s"),
    ],
)
def test_log_says_why_the_handler_is_not_called(
    send: Callable[[Any], None], why: str, caplog: pytest.LogCaptureFixture
) -> None:
    with ModuleHarness(Pairs) as harness, caplog.at_level(logging.WARNING):
        send(harness)
        for ms in range(200):
            harness.send(image(ms), topic="camera")
    (record,) = caplog.records
    assert why in record.getMessage()


def refuse(*inputs: Any, **options: Any) -> RobbieError:
    class Refused(Module):
        def setup(self) -> None:
            Synchronizer(self, *inputs, handler=lambda *_: None, **options)

    with pytest.raises(RobbieError) as caught, ModuleHarness(Refused):
        pass
    return caught.value


def test_bad_use_is_refused() -> None:
    assert "two or more inputs; got 1" in str(refuse(Image))
    assert "String has no header.stamp" in str(refuse(Image, String))
    assert "tolerance_s is -1" in str(refuse(Image, LaserScan, tolerance_s=-1))
    assert "tolerance_s is nan" in str(refuse(Image, LaserScan, tolerance_s=float("nan")))
    assert "max_waiting is 0" in str(refuse(Image, LaserScan, max_waiting=0))
    assert "camera: min_period_s is -1" in str(refuse(Input(Image, "camera", min_period_s=-1), LaserScan))
    assert isinstance(refuse(Image, Image), SubscribedTwice)
    assert issubclass(CannotSynchronize, ValueError)


class Odd(Message, name="tests/msg/Odd"):
    """A message whose header is something else."""

    header: String


def test_header_of_another_type_is_no_stamp() -> None:
    assert "Odd has no header.stamp" in str(refuse(Image, Odd))
