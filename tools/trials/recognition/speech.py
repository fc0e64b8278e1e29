"""Measures how well spoken orders are understood, and how often other speech is taken for one.

    python -m tools.trials speech [--recordings ../shared/data/home/speech] [--voices 4]

- Synthetic: the sentences of a household robot in several voices of espeak-ng, clean and with pink noise.
- Real (with `--recordings`): orders in a café by many people, with a grammar of that café
  (Picovoice/speech-to-intent-benchmark). An order is right if all its labelled slots are.
- Other speech: sentences outside the grammar, and recordings of digits, playing cards, a book and café
  orders, all heard with the household's grammar.

Needs the extras `speech` and `camera` (PyAV, which decodes FLAC), and espeak-ng.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.speech.order_grammar import OrderGrammar
from robbie_robots.workers.speech.order_recognizer import RATE_HZ, Heard, OrderRecognizer
from robbie_robots.workers.speech.voice import speak
from tools.trials.harness import Case, TrialSubject

VOICES = ["en-us", "en-us+f2", "en-us+m3", "en-gb", "en-gb-x-rp+f3", "en-us+f4", "en-gb-scotland", "en-gb+m7"]
NOISES_DB = [None, 20.0, 10.0]
HOME = OrderGrammar(
    {
        "follow": ["[please] follow me", "come with me"],
        "stop": ["stop", "stand still"],
        "bring": ["[please] (bring | get | fetch) me (the | a | an) <object> [from the <place>]"],
        "put": ["put (it | the <object>) on the <place>"],
        "go": ["[please] go to the <place>"],
        "find": ["(find | look for) <person>"],
        "who": ["who is <person>", "who is who"],
        "learn": ["this is the <place>", "my name is <person>"],
    },
    {
        "object": [
            "cup",
            "bottle",
            "red box",
            "orange juice",
            "apple",
            "book",
            "cereal",
            "coke",
            "biscuits",
            "newspaper",
        ],
        "place": [
            "kitchen",
            "kitchen table",
            "living room",
            "sofa",
            "shelf",
            "bedroom",
            "door",
            "bathroom",
            "desk",
        ],
        "person": ["anna", "michael", "susan", "peter", "john", "maria", "david", "emma"],
    },
)
SPOKEN = [
    "follow me", "please follow me", "come with me", "stop", "stand still", "bring me the cup",
    "please bring me a bottle", "fetch me the red box from the kitchen", "get me the orange juice",
    "bring me an apple from the living room", "put it on the kitchen table", "put the book on the shelf",
    "go to the sofa", "please go to the bedroom", "find anna", "look for michael", "who is susan",
    "who is who",
    "this is the kitchen", "my name is peter", "fetch me the cereal", "get me a coke from the shelf",
    "bring me the newspaper", "go to the door", "put the biscuits on the desk",
]  # fmt: skip
OTHER = [
    "what time is it", "open the window please", "i would like to sleep now", "the weather is nice today",
    "my sister lives in paris", "turn the music off", "how far is the station", "do you know the answer",
    "he went to the market", "they are bringing the children", "the cup final was boring",
    "going home late is bad", "stopwatches are useful", "bring the car around the corner",
    "the kitchen is dirty", "follow the money",
]  # fmt: skip
_EXTRAS = ("[with <milk> [and <sugar>]]", "[with <sugar> [and <milk>]]")
_DRINKS = (
    "[<size>] [<roast>] [<shots>]", "[<size>] [<shots>] [<roast>]", "[<roast>] [<size>] [<shots>]",
    "[<roast>] [<shots>] [<size>]", "[<shots>] [<size>] [<roast>]", "[<shots>] [<roast>] [<size>]",
)  # fmt: skip
_BEGINNING = "(brew | can i get | can i have | i want | get me | give me | i'd like | make me | may i have)"
_AMOUNTS = ["", "a little bit of ", "a bit of ", "some ", "a lot of ", "lots of "]
CAFE = OrderGrammar(
    {"order": [f"{_BEGINNING} [a | an] {drink} <drink> {extra}" for drink in _DRINKS for extra in _EXTRAS]},
    {
        "drink": ["americano", "cappuccino", "espresso", "latte", "mocha", "iced mocha"]
        + [f"{kind}coffee" for kind in ("", "drip ", "house ", "iced ")],
        "size": ["small", "medium", "large", "eight ounce", "twelve ounce", "sixteen ounce", "twenty ounce"],
        "roast": ["light roast", "medium roast", "dark roast"],
        "shots": ["single shot", "double shot", "triple shot"],
        "milk": [
            f"{amount}{kind}milk"
            for amount in _AMOUNTS
            for kind in ("", "skim ", "whole ", "soy ", "almond ")
        ]
        + [f"{amount}cream" for amount in _AMOUNTS],
        "sugar": [f"{amount}{kind}" for amount in _AMOUNTS for kind in ("sugar", "brown sugar", "sweetener")],
    },
)


@dataclass(frozen=True)
class SpokenTrial:
    """An utterance.

    Attributes:
        kind: the row of the table.
        samples: (N,) int16, 16 kHz.
        grammar: "home" or "cafe".
        text: what is said in the grammar; "" for other speech.
        slots: labelled values, which an order must have; for real recordings.
    """

    kind: str
    samples: NDArray[np.int16]
    grammar: str = "home"
    text: str = ""
    slots: tuple[str, ...] = ()

    def judge(self, heard: Heard) -> str:
        """Return "right", "wrong" or "refused"."""
        if heard.order is None:
            return "refused"
        if self.slots:
            return "right" if all(f" {slot} " in f" {heard.order.text} " for slot in self.slots) else "wrong"
        expected = HOME.parse(self.text)
        same = expected is not None and (expected.order, expected.slots) == (
            heard.order.order,
            heard.order.slots,
        )
        return "right" if same else "wrong"


def with_noise(samples: NDArray[np.int16], noise_db: float | None, seed: int) -> NDArray[np.int16]:
    """Return speech with pink noise below it, and silence around it.

    Args:
        samples: (N,) int16.
        noise_db: how much weaker the noise is than the speech; None: almost none.
        seed: of the noise.
    """
    speech = np.concatenate([np.zeros(4000), samples.astype(float), np.zeros(4000)])
    random = np.random.default_rng(seed)
    spectrum = np.fft.rfft(random.standard_normal(len(speech)))
    noise = np.fft.irfft(spectrum / np.sqrt(np.maximum(1, np.arange(len(spectrum)))), len(speech))
    level = np.sqrt(np.mean(speech[np.abs(speech) > 200] ** 2) / np.mean(noise**2))
    noise *= level / 10 ** ((60.0 if noise_db is None else noise_db) / 20)
    return np.clip(np.round(speech + noise), -32_768, 32_767).astype(np.int16)


def synthetic(voices: int) -> Iterator[SpokenTrial]:
    """Yield spoken sentences, in the grammar and outside it."""
    for number, (text, voice) in enumerate((text, voice) for text in SPOKEN for voice in VOICES[:voices]):
        spoken = speak(text, RATE_HZ, voice)
        for noise_db in NOISES_DB:
            kind = "espeak-ng, " + ("clean" if noise_db is None else f"noise at {noise_db:g} dB")
            yield SpokenTrial(kind, with_noise(spoken, noise_db, number), text=text)
    for number, (text, voice) in enumerate((text, voice) for text in OTHER for voice in VOICES[:voices]):
        yield SpokenTrial("other speech: espeak-ng", with_noise(speak(text, RATE_HZ, voice), None, number))


def real(folder: Path) -> Iterator[SpokenTrial]:
    """Yield recordings of people."""
    labels = json.loads((folder / "coffee" / "label.json").read_text())
    for number, (name, label) in enumerate(labels.items()):
        samples = read_sound(folder / "coffee" / name)
        slots = tuple(value.strip() for value in label["slots"].values())
        yield SpokenTrial("real orders", samples, "cafe", slots=slots)
        yield SpokenTrial(
            "real orders, noise at 20 dB", with_noise(samples, 20.0, number), "cafe", slots=slots
        )
        yield SpokenTrial("other speech: café orders", samples)
    for name in ("digits", "cards", "pocketsphinx"):
        for file in sorted((folder / name).glob("*.wav")):
            yield SpokenTrial(f"other speech: {name}", with_noise(read_sound(file), None, 0))
    for file in sorted((folder / "librivox").glob("*.wav")):
        book, length = read_sound(file), 3 * RATE_HZ
        for start in range(0, max(1, len(book) - length // 2), length // 2):
            yield SpokenTrial("other speech: a book", book[start : start + length])


def read_sound(file: Path) -> NDArray[np.int16]:
    """Return a sound file's samples, (N,) int16 at 16 kHz."""
    import av  # noqa: PLC0415 (an extra)

    with av.open(str(file)) as opened:
        resampler = av.AudioResampler("s16", "mono", RATE_HZ)
        frames = [one for frame in opened.decode(audio=0) for one in resampler.resample(frame)]
        frames += resampler.resample(None)
    return np.concatenate([frame.to_ndarray().ravel() for frame in frames]).astype(np.int16)


def play(case: Case) -> dict[str, Any]:
    """Recognize all utterances."""
    chosen = case.options
    recordings = real(chosen.recordings) if chosen.recordings else ()
    return heard([*synthetic(chosen.voices), *recordings], details=chosen.details)


def heard(trials: list[SpokenTrial], *, details: bool = False) -> dict[str, Any]:
    """Recognize utterances; return what was right for each kind, and the processor time for one, s."""
    recognizer = OrderRecognizer({"home": HOME, "cafe": CAFE})
    counts: dict[str, Counter[str]] = {}
    used_s = 0.0
    for trial in trials:
        before_s = time.process_time()
        found = recognizer.recognize(trial.samples, trial.grammar)
        used_s += time.process_time() - before_s
        is_order = bool(trial.text or trial.slots)
        judged = trial.judge(found) if is_order or found.order is None else "wrong"
        counts.setdefault(trial.kind, Counter())[judged] += 1
        if details and judged != ("right" if is_order else "refused"):
            print(f'{trial.kind}: {judged}: "{trial.text or " ".join(trial.slots)}": {found}', flush=True)
    recognizer.close()
    kinds = {kind: {"of": counted.total(), **counted} for kind, counted in counts.items()}
    return kinds | {"processor_s": round(used_s / len(trials), 2)}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of utterances."""
    recordings = "folder with coffee/, digits/, cards/, librivox/"
    parser.add_argument("--recordings", type=Path, help=recordings)
    voices = range(1, len(VOICES) + 1)
    parser.add_argument("--voices", type=int, default=4, choices=voices, help="of espeak-ng (4)")
    parser.add_argument("--details", action="store_true", help="print each utterance that is not right")


SUBJECT = TrialSubject(play=play, options=options, seeds=1, seed_makes="nothing: noise is always the same")
