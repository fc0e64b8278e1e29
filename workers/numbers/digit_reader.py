"""Reads digits with the recogniser for lines of text of PP-OCRv4, which rapidocr ships before version 3.8.

The network (Du et al., "PP-OCR: A practical ultra lightweight OCR system", 2020; version 4 of 2023) gives for
each step along the line the probability of each character, to be decoded as by Graves et al., "Connectionist
temporal classification" (ICML 2006): repeated characters are one, and the blank is none.
"""

import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

PACKAGE = "rapidocr"
MODEL = "models/ch_PP-OCRv4_rec_infer.onnx"
LINE_PX = 48
"""The network reads lines of this height."""
BLANK = 0
MAX_LINE_PX = 960
# Fields of ONNX's messages ModelProto and StringStringEntryProto (onnx.proto).
METADATA, KEY, VALUE = 14, 1, 2


class ReaderMissing(ImportError):
    """The package with the network, or the one that runs it, is not installed."""


@dataclass(frozen=True)
class Reading:
    """What is written somewhere.

    Attributes:
        text: the characters.
        confidence: 0 … 1, the least probability of a character; 0 for no character.
    """

    text: str
    confidence: float

    @property
    def is_number(self) -> bool:
        """Return whether the text consists of the digits 0 to 9 alone."""
        return self.text.isascii() and self.text.isdigit()


class LineReader:
    """Reads one line of text.

    Raises:
        ReaderMissing: `rapidocr` or OpenCV is not installed.
    """

    def __init__(self) -> None:
        spec = find_spec(PACKAGE)
        places = [] if spec is None else list(spec.submodule_search_locations or [])
        # Only the network's file is used, and OpenCV runs it: an import of the package would need seconds.
        model = Path(places[0]) / MODEL if places else None
        if model is None or not model.exists():
            raise ReaderMissing("digits are read with rapidocr before 3.8: install it (extra 'digits')")
        try:
            self._cv2: Any = import_module("cv2")
        except ImportError as error:
            raise ReaderMissing("digits are read with OpenCV: install it (extra 'digits')") from error
        self._cv2.setNumThreads(1)  # leave the robot's other processor cores free
        self._network = self._cv2.dnn.readNetFromONNX(str(model))
        self._characters = ["", *_metadata(model.read_bytes())["character"].splitlines(), " "]

    def read(self, line: Image) -> Reading:
        """Read a line of text that fills an image almost.

        Args:
            line: (height, width) uint8, dark text on a light ground or the reverse.
        """
        height, width = line.shape
        columns = min(MAX_LINE_PX, max(LINE_PX, round(width * LINE_PX / height)))
        scaled = self._cv2.resize(line, (columns, LINE_PX), interpolation=self._cv2.INTER_AREA)
        values = scaled.astype(np.float32) / 127.5 - 1.0
        self._network.setInput(np.ascontiguousarray(np.broadcast_to(values, (1, 3, *values.shape))))
        probabilities = self._network.forward()[0]
        best = probabilities.argmax(axis=1)
        begins = np.flatnonzero((best != BLANK) & (best != np.concatenate([[BLANK], best[:-1]])))
        if not len(begins):
            return Reading("", 0.0)
        text = "".join(self._characters[code] for code in best[begins])
        # The network also knows the wide digits of Chinese text.
        text = unicodedata.normalize("NFKC", text).replace(" ", "")
        return Reading(text, float(probabilities[begins, best[begins]].min()))


def _metadata(model: bytes) -> dict[str, str]:
    """Return the texts that an ONNX file says about itself; OpenCV does not give them."""
    found = {}
    for number, value in _fields(memoryview(model)):
        if number == METADATA:
            entry = {key: bytes(text).decode() for key, text in _fields(value)}
            found[entry[KEY]] = entry[VALUE]
    return found


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Return number and bytes of each field with a length of a Protocol Buffers message."""
    place = 0
    while place < len(message):
        tag, place = _varint(message, place)
        if tag & 7 == 0:
            _, place = _varint(message, place)
        elif tag & 7 == 2:
            length, place = _varint(message, place)
            yield tag >> 3, message[place : place + length]
            place += length
        else:
            place += 8 if tag & 7 == 1 else 4


def _varint(message: memoryview, place: int) -> tuple[int, int]:
    """Return a number at a place, and the place after it."""
    value = shift = 0
    while True:
        byte = message[place]
        value |= (byte & 0x7F) << shift
        place, shift = place + 1, shift + 7
        if byte < 0x80:
            return value, place
