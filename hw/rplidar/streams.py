"""The streams of RPLidars: all samples of a batch of frames are decoded at once.

Source: Shanghai Slamtec, RPLIDAR Interface Protocol and Application Notes.
"""

import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.rplidar.protocol import CAPSULES, DENSE_CAPSULES, HQ_CAPSULES, NODES, ULTRA_CAPSULES

FULL_TURN_DEG = 360.0
Bytes = NDArray[np.uint8]
Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Ultra capsules: the levels of their logarithmic code: code from which one begins, range there, bits lost.
LEVELS = ((0, 0, 0), (512, 512, 1), (1280, 2048, 2), (1792, 4096, 3), (3328, 16_384, 4))
MAJOR_BITS, PREDICTION_BITS = 12, 10
# Predictions that mean: no return.
NO_RETURNS = (-512, 511)


@dataclass(frozen=True)
class Samples:
    """Samples in the order in which they were measured, N of them.

    Attributes:
        angles_deg: (N,), clockwise seen from above, 0 ahead, 0 to 360.
        distances_mm: (N,); 0: no return.
        qualities: (N,) strength of the return; None: the stream does not tell it.
        firsts: (N,) whether a new turn begins with the sample.
    """

    angles_deg: Reals
    distances_mm: Reals
    qualities: Reals | None
    firsts: Flags

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.angles_deg)

    def part(self, begin: int, end: int) -> "Samples":
        """Return the samples from `begin` up to `end`."""
        quality = None if self.qualities is None else self.qualities[begin:end]
        return Samples(
            self.angles_deg[begin:end], self.distances_mm[begin:end], quality, self.firsts[begin:end]
        )


NO_SAMPLES = Samples(np.zeros(0), np.zeros(0), None, np.zeros(0, np.bool_))


def joined(parts: list[Samples]) -> Samples:
    """Return all samples of some parts of one stream, in order."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return NO_SAMPLES
    qualities = [part.qualities for part in parts if part.qualities is not None]
    return Samples(
        np.concatenate([part.angles_deg for part in parts]),
        np.concatenate([part.distances_mm for part in parts]),
        np.concatenate(qualities) if qualities else None,
        np.concatenate([part.firsts for part in parts]),
    )


class StreamReader(ABC):
    """Cuts a stream into frames of one size, and these into samples. What is damaged is left out and counted.

    Attributes:
        frame_bytes: size of a frame.
        frame_samples: samples in it.
        damaged: frames that were found damaged.
        skipped_bytes: bytes outside of intact frames.
        frames: intact frames.
        pending: samples that have arrived and whose direction is not known before the next frame.
        gaps: how often something was lost before an intact frame.
    """

    frame_bytes: int
    frame_samples: int
    # Frames in a row that must look right before the reader believes to be in step.
    frames_in_step = 1

    def __init__(self) -> None:
        self.damaged = self.skipped_bytes = self.frames = self.pending = self.gaps = 0
        self._buffer = b""
        self._is_in_step = False
        self._has_lost = False

    def feed(self, data: bytes) -> Samples:
        """Take bytes in pieces of any length; return the samples whose directions are known now.

        A turn that lost a part cannot be told from a whole one here: see `gaps`. Only samples behind the last
        gap are returned.
        """
        parts: list[Samples] = []
        for frames in self._frames(self._buffer + data):
            if self._has_lost:
                self._has_lost = False
                self.gaps += 1
                self.break_off()
                parts.clear()
            self.frames += len(frames)
            parts.append(self.samples(frames))
        return joined([part for part in parts if len(part)])

    @property
    def buffered_bytes(self) -> int:
        """Return how many bytes wait for the rest of their frame."""
        return len(self._buffer)

    def forget(self) -> None:
        """Forget half a frame."""
        self.skipped_bytes += len(self._buffer)
        self._buffer = b""
        self._is_in_step = self._has_lost = False
        self.break_off()

    @abstractmethod
    def good(self, frames: Bytes) -> Flags:
        """Return which frames are intact: (N,), of (N, frame_bytes)."""

    @abstractmethod
    def may_begin(self, data: Bytes) -> Flags:
        """Return at which bytes, of (N,), an intact frame could begin: (N - 1,)."""

    @abstractmethod
    def samples(self, frames: Bytes) -> Samples:
        """Return the samples of intact frames, (N, frame_bytes), as far as they are known."""

    @abstractmethod
    def break_off(self) -> None:
        """Forget the last frame: the next one does not follow it."""

    def _frames(self, buffer: bytes) -> Iterator[Bytes]:
        """Yield runs of intact frames; keep the rest."""
        at, size = 0, self.frame_bytes
        while True:
            wanted = 1 if self._is_in_step else self.frames_in_step
            count = (len(buffer) - at) // size
            if count < wanted:
                break
            count = count if self._is_in_step else wanted
            frames = np.frombuffer(buffer, np.uint8, count * size, at).reshape(count, size)
            good = self.good(frames)
            intact = count if good.all() else int(good.argmin())
            if intact < wanted:
                at = self._next_beginning(buffer, at)
                continue
            yield frames[:intact]
            self._is_in_step = True
            at += intact * size
            if intact < count:
                self.damaged += 1
                self._lose_step()
        self._buffer = buffer[at:]

    def _lose_step(self) -> None:
        self._is_in_step, self._has_lost = False, True

    def _next_beginning(self, buffer: bytes, at: int) -> int:
        """Return the next place where a frame could begin; what lies before it is skipped."""
        if self._is_in_step:
            self.damaged += 1
        self._lose_step()
        rest = np.frombuffer(buffer, np.uint8, offset=at + 1)
        found = np.flatnonzero(self.may_begin(rest)) if len(rest) > 1 else np.zeros(0, np.int64)
        # The last byte may be the first one of a beginning.
        skipped = 1 + (int(found[0]) if len(found) else max(len(rest) - 1, 0))
        self.skipped_bytes += skipped
        return at + skipped


class NodeReader(StreamReader):
    """The stream of SCAN: samples of five bytes, which have two check bits and no checksum."""

    frame_bytes, frame_samples = 5, 1
    # Noise often looks like one.
    frames_in_step = 3

    def good(self, frames: Bytes) -> Flags:
        """Return which samples have right check bits and a possible direction."""
        first, low = frames[:, 0], frames[:, 1]
        # 360 degrees in steps of 1/64.
        angles = low.astype(np.int64) >> 1 | frames[:, 2].astype(np.int64) << 7
        checked: Flags = ((first & 1) != (first >> 1 & 1)) & ((low & 1) == 1)
        return checked & (angles <= FULL_TURN_DEG * 64)

    def may_begin(self, data: Bytes) -> Flags:
        """Return where the check bits of a sample are right."""
        checked: Flags = ((data[:-1] & 1) != (data[:-1] >> 1 & 1)) & ((data[1:] & 1) == 1)
        return checked

    def samples(self, frames: Bytes) -> Samples:
        """Return the samples."""
        wide = frames.astype(np.int64)
        return Samples(
            (wide[:, 1] >> 1 | wide[:, 2] << 7) / 64,
            (wide[:, 3] | wide[:, 4] << 8) / 4,
            (wide[:, 0] >> 2).astype(np.float64),
            (wide[:, 0] & 1) == 1,
        )

    def break_off(self) -> None:
        """Do nothing: samples do not depend on each other."""


class HqReader(StreamReader):
    """Frames of 16 samples, each with its direction and quality, and a CRC over all."""

    frame_bytes, frame_samples = 141, 16
    SYNC = 0xA5
    # Sync and the laser's time, which firmware may leave at 0.
    HEAD_BYTES, CRC_BYTES = 9, 4
    NODE = np.dtype([("angle", "<u2"), ("distance", "<u4"), ("quality", "u1"), ("flags", "u1")])
    PADDING = bytes(3)

    def good(self, frames: Bytes) -> Flags:
        """Return which frames have the right checksum: their bytes count filled up to a multiple of four."""
        checked = [
            frame[0] == self.SYNC
            and zlib.crc32(frame[: -self.CRC_BYTES].tobytes() + self.PADDING)
            == int.from_bytes(frame[-self.CRC_BYTES :].tobytes(), "little")
            for frame in frames
        ]
        return np.array(checked, np.bool_)

    def may_begin(self, data: Bytes) -> Flags:
        """Return where the mark of a frame stands."""
        marked: Flags = data[:-1] == self.SYNC
        return marked

    def samples(self, frames: Bytes) -> Samples:
        """Return the samples."""
        inside = np.ascontiguousarray(frames[:, self.HEAD_BYTES : -self.CRC_BYTES])
        nodes = inside.view(self.NODE).ravel()
        firsts: Flags = (nodes["flags"] & 1) == 1
        return Samples(
            nodes["angle"] * (90.0 / 16_384) % FULL_TURN_DEG,
            nodes["distance"] / 4.0,
            nodes["quality"].astype(np.float64),
            firsts,
        )

    def break_off(self) -> None:
        """Do nothing: frames do not depend on each other."""


class CapsuleReader(StreamReader):
    """The stream of the express mode: capsules of 32 samples with a checksum.

    The directions of a capsule's samples lie between its own and that of the next one, so they are known when
    the next one is there.
    """

    frame_bytes, frame_samples = 84, 32
    HEAD_BYTES = 4

    def __init__(self) -> None:
        super().__init__()
        self._last: Bytes | None = None
        self._last_deg = FULL_TURN_DEG

    def good(self, frames: Bytes) -> Flags:
        """Return which capsules have the right marks and checksum."""
        first, second = frames[:, 0], frames[:, 1]
        told = first & 15 | (second & 15) << 4
        is_good: Flags = np.bitwise_xor.reduce(frames[:, 2:], axis=1) == told
        is_good &= (first >> 4 == 0xA) & (second >> 4 == 0x5)
        return is_good

    def may_begin(self, data: Bytes) -> Flags:
        """Return where the two marks of a capsule stand."""
        marked: Flags = (data[:-1] >> 4 == 0xA) & (data[1:] >> 4 == 0x5)
        return marked

    def samples(self, frames: Bytes) -> Samples:
        """Return the samples of all capsules that another one follows."""
        # Where the laser has begun again, a capsule does not follow the one before it.
        restarts = np.flatnonzero(frames[:, 3] & 0x80)
        parts, begin = [], 0
        for end in [*restarts.tolist(), len(frames)]:
            if end > begin:
                parts.append(self._run(frames[begin:end]))
            if end < len(frames):
                self.break_off()
            begin = end
        return joined([part for part in parts if len(part)])

    def break_off(self) -> None:
        """Forget the last capsule."""
        self._last, self._last_deg, self.pending = None, FULL_TURN_DEG, 0

    def distances_and_offsets(self, frames: Bytes) -> tuple[Reals, Reals]:
        """Return distances, mm, and how far the beams lie behind the mirror, degrees: (N - 1, samples)."""
        cabins = frames[:-1, self.HEAD_BYTES :].reshape(len(frames) - 1, 16, 5).astype(np.int64)
        words = np.stack([cabins[..., 0] | cabins[..., 1] << 8, cabins[..., 2] | cabins[..., 3] << 8], -1)
        low = np.stack([cabins[..., 4] & 15, cabins[..., 4] >> 4], -1)
        # Eighths of a degree: a sign, and five bits whose upper one stands in the distance's word.
        eighths = ((words & 1) << 4 | low) * np.where(words >> 1 & 1, -1, 1)
        shape = (len(frames) - 1, self.frame_samples)
        return (words >> 2).reshape(shape).astype(np.float64), (eighths / 8.0).reshape(shape)

    def _run(self, frames: Bytes) -> Samples:
        """Return the samples of capsules that follow each other, but for the last one's."""
        if self._last is not None:
            frames = np.concatenate([self._last[np.newaxis], frames])
        self._last, self.pending = frames[-1].copy(), self.frame_samples
        if len(frames) < 2:
            return NO_SAMPLES
        starts = ((frames[:, 2].astype(np.int64) | frames[:, 3].astype(np.int64) << 8) & 0x7FFF) / 64.0
        steps = (np.diff(starts) % FULL_TURN_DEG) / self.frame_samples
        swept = starts[:-1, np.newaxis] + steps[:, np.newaxis] * np.arange(self.frame_samples)
        swept = swept.ravel() % FULL_TURN_DEG
        # A turn is counted by the direction of the mirror, which grows until it begins again.
        firsts = np.diff(swept, prepend=self._last_deg if self._last_deg < FULL_TURN_DEG else swept[0]) < 0
        self._last_deg = float(swept[-1])
        distances, offsets = self.distances_and_offsets(frames)
        return Samples((swept - offsets.ravel()) % FULL_TURN_DEG, distances.ravel(), None, firsts)


class DenseReader(CapsuleReader):
    """Capsules of 40 samples at even directions, whose distances are whole millimetres."""

    frame_bytes, frame_samples = 84, 40

    def distances_and_offsets(self, frames: Bytes) -> tuple[Reals, Reals]:
        """Return distances, mm; beams do not lie behind the mirror: (N - 1, samples)."""
        words = np.ascontiguousarray(frames[:-1, self.HEAD_BYTES :]).view("<u2")
        return words.astype(np.float64), np.zeros(words.shape)


class UltraReader(CapsuleReader):
    """Capsules of 96 samples: of each three, one in a logarithmic code, and two by their difference to it."""

    frame_bytes, frame_samples = 132, 96
    CABINS = 32

    def __init__(self) -> None:
        super().__init__()
        codes = np.arange(1 << MAJOR_BITS)
        self._ranges, self._bits = codes.copy(), np.zeros_like(codes)
        for begin, range_mm, bits in LEVELS:
            self._ranges[begin:] = range_mm + ((codes[begin:] - begin) << bits)
            self._bits[begin:] = bits

    def distances_and_offsets(self, frames: Bytes) -> tuple[Reals, Reals]:
        """Return distances, mm, and how far the beams lie behind the mirror, degrees: (N - 1, samples)."""
        cabins = np.ascontiguousarray(frames[:, self.HEAD_BYTES :]).view("<u4").astype(np.int64)
        # The last cabin of a capsule needs the first one of the next.
        flat = cabins.ravel()[: (len(frames) - 1) * self.CABINS + 1]
        codes = flat & ((1 << MAJOR_BITS) - 1)
        majors, bits = self._ranges[codes], self._bits[codes]
        flat, major, after = flat[:-1], majors[:-1], majors[1:]
        is_missing = (major == 0) & (after != 0)
        one = _predicted(
            flat >> MAJOR_BITS, np.where(is_missing, after, major), np.where(is_missing, bits[1:], bits[:-1])
        )
        two = _predicted(flat >> (MAJOR_BITS + PREDICTION_BITS), after, bits[1:])
        distances = np.stack([major, one, two], -1).reshape(len(frames) - 1, self.frame_samples)
        return distances.astype(np.float64), _ultra_offsets_deg(distances)


def _predicted(words: NDArray[np.int64], bases: NDArray[np.int64], bits: NDArray[np.int64]) -> Reals:
    """Return the distances, mm, that differ from others by signed numbers in the low bits of words: (N,)."""
    half = 1 << (PREDICTION_BITS - 1)
    numbers = ((words & (2 * half - 1)) ^ half) - half
    is_there = (numbers != NO_RETURNS[0]) & (numbers != NO_RETURNS[1])
    distances: Reals = np.where(is_there, np.maximum(bases + numbers * (1 << bits), 0), 0).astype(np.float64)
    return distances


def _ultra_offsets_deg(distances_mm: Reals) -> Reals:
    """Return how far beams lie behind the mirror: receiver and laser stand beside each other."""
    near = np.trunc(98_361.0 / np.maximum(distances_mm * 4, 200.0))
    radians = np.radians(8.0) - (near * 64 + np.trunc(near**3 / 98_304)) / 65_536
    offsets: Reals = np.where(distances_mm >= 50.0, np.degrees(radians), 7.5)
    return offsets


READERS: dict[int, type[StreamReader]] = {
    NODES: NodeReader,
    CAPSULES: CapsuleReader,
    HQ_CAPSULES: HqReader,
    ULTRA_CAPSULES: UltraReader,
    DENSE_CAPSULES: DenseReader,
}
