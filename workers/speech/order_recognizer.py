"""Recognises spoken orders of a grammar, and refuses what is none.

A recogniser with a grammar turns nearly any speech into one of its sentences. So a second one, which knows
no grammar, writes down what it hears, and an order counts only if both sound alike, or if what was written
down is nearly a sentence of the grammar by itself. The first one is `pocketsphinx` with CMU's acoustic model
of American English, the second one `moonshine-voice` with its model "tiny" (Jeffries et al., "Moonshine:
Speech Recognition for Live Transcription and Voice Commands", 2024). Both carry their models in their
packages; nothing is fetched.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.speech.nearest_sentence import NearestSentence
from robbie_robots.workers.speech.order_grammar import WORD, OrderGrammar, SpokenWords, WrongGrammar, spoken
from robbie_robots.workers.speech.pronunciation import CONSONANTS, VOWELS, distance, phonemes

RATE_HZ = 16_000
SURE_DISTANCE = 0.1
"""A sentence of the grammar that is so near to what was heard without a grammar counts in any case."""
MAX_DISTANCE = 0.55
"""Utterances whose two readings are further apart are refused; see docs/speech.md."""


FAINT = 4
"""Amplitude of the noise that is added to all sound; 16 bits."""


class SpeechPackagesMissing(ImportError):
    """The packages that understand speech are not installed.

    Example:
        `pip install robbie-mp` without `[speech]`.
    """


@dataclass(frozen=True)
class Heard:
    """What an utterance gave.

    Attributes:
        order: the order, or None if it was refused.
        nearest: the sentence of the grammar that fits best; empty if none does.
        transcript: what was heard without a grammar.
        distance: between the two, 0 (they sound alike) to 1.
    """

    order: SpokenWords | None
    nearest: str
    transcript: str
    distance: float


class OrderRecognizer:
    """Recognises the orders of grammars in utterances.

    Args:
        grammars: each by a name; `recognize` uses one of them.
        pronunciations: of words that the dictionary does not know, in the phonemes of the CMU dictionary,
            such as {"robbie": "R AA B IY"}.
        max_distance: see MAX_DISTANCE.

    Raises:
        SpeechPackagesMissing: see there.
        WrongGrammar: a word that nobody knows how to pronounce, or a pronunciation with unknown phonemes.
        GrammarTooLarge: see `NearestSentence`.
    """

    def __init__(
        self,
        grammars: Mapping[str, OrderGrammar],
        pronunciations: Mapping[str, str] | None = None,
        max_distance: float = MAX_DISTANCE,
    ) -> None:
        try:
            from moonshine_voice import ModelArch, get_assets_path  # noqa: PLC0415 (an extra)
            from moonshine_voice.transcriber import Transcriber  # noqa: PLC0415
            from pocketsphinx import Decoder  # noqa: PLC0415
        except ImportError as error:
            raise SpeechPackagesMissing(
                "speech needs pocketsphinx and moonshine-voice: "
                f"pip install pocketsphinx moonshine-voice==0.0.49 ({error})"
            ) from error
        self._grammars: dict[str, OrderGrammar] = {}
        self._sentences: dict[str, NearestSentence] = {}
        self.max_distance = max_distance
        self._decoder = Decoder(lm=None, loglevel="FATAL")
        for word, told in (pronunciations or {}).items():
            self._learn(word, told)
        for name, grammar in grammars.items():
            self.use(name, grammar)
        self._transcriber = Transcriber(str(Path(get_assets_path()) / "tiny-en"), ModelArch.TINY)

    def use(self, name: str, grammar: OrderGrammar) -> None:
        """Add a grammar, or replace the one of this name.

        Raises:
            WrongGrammar: nobody knows how to pronounce a word; nothing has changed.
            GrammarTooLarge: see `NearestSentence`; nothing has changed.
        """
        self._check(grammar)
        sentences = NearestSentence(grammar, self._decoder.lookup_word)
        self._decoder.add_jsgf_string(name, grammar.jsgf)
        self._grammars[name], self._sentences[name] = grammar, sentences

    def can_pronounce(self, text: str) -> bool:
        """Return whether the dictionary knows every word of a text."""
        return all(self._decoder.lookup_word(word) is not None for word in spoken(text).split())

    def recognize(self, samples: NDArray[np.int16], grammar: str) -> Heard:
        """Return what an utterance says.

        Args:
            samples: (N,) int16, 16 kHz.
            grammar: the name of the grammar that holds now.
        """
        transcript = self._transcript(samples)
        heard = self._phonemes(transcript)
        nearest = self._sentences[grammar].find(heard)
        apart = distance(self._phonemes(nearest), heard)
        if apart > SURE_DISTANCE:
            nearest = self._best_sentence(samples, grammar)
            apart = distance(self._phonemes(nearest), heard)
        order = self._grammars[grammar].parse(nearest) if apart <= self.max_distance else None
        return Heard(order, nearest, transcript, apart)

    def close(self) -> None:
        """Let go of the models."""
        self._transcriber.close()

    def _best_sentence(self, samples: NDArray[np.int16], grammar: str) -> str:
        # The decoder gives up on exact zeros, which recordings have: their energy has no logarithm.
        noise = np.random.default_rng(0).integers(-FAINT, FAINT, len(samples), endpoint=True)
        self._decoder.activate_search(grammar)
        self._decoder.start_utt()
        try:
            audible = np.clip(samples + noise, -32_768, 32_767).astype("<i2")
            self._decoder.process_raw(audible.tobytes(), full_utt=True)
        finally:
            self._decoder.end_utt()
        found = self._decoder.hyp()
        return str(found.hypstr) if found is not None else ""

    def _transcript(self, samples: NDArray[np.int16]) -> str:
        found = self._transcriber.transcribe_without_streaming((samples / 32_768.0).tolist(), RATE_HZ)
        return " ".join(line.text for line in found.lines).lower()

    def _phonemes(self, text: str) -> list[str]:
        return phonemes(WORD.findall(text.lower()), self._decoder.lookup_word)

    def _learn(self, word: str, told: str) -> None:
        if not WORD.fullmatch(word):
            raise WrongGrammar(f'"{word}" is no word; pronunciations are of single words in lower case')
        wrong = [each for each in told.split() if each not in VOWELS | CONSONANTS]
        if wrong or not told.split():
            raise WrongGrammar(
                f'the pronunciation "{told}" of "{word}" has the unknown phoneme "{(wrong or [""])[0]}"; '
                f"there are {' '.join(sorted(VOWELS | CONSONANTS))}"
            )
        self._decoder.add_word(word, told, True)

    def _check(self, grammar: OrderGrammar) -> None:
        unknown = sorted(word for word in grammar.vocabulary if self._decoder.lookup_word(word) is None)
        if unknown:
            raise WrongGrammar(
                f"the dictionary does not know {', '.join(unknown)}; write how each is pronounced under "
                '`pronunciations`, such as {robbie: "R AA B IY"}'
            )
