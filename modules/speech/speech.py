"""The robot's ear and voice: spoken orders, and spoken texts."""

from collections import deque

import numpy as np
from numpy.typing import NDArray
from strenum import StrEnum

from robbie_mp import (
    REQUIRED,
    Header,
    MessageHandling,
    Module,
    SettingError,
    StateMachine,
    TimeOut,
    replace,
    setting,
)
from robbie_mp.messages import RawAudio, TaughtNames
from robbie_robots.modules.speech.messages import Say, SpokenOrder, SpokenSlot
from robbie_robots.workers.speech.nearest_sentence import GrammarTooLarge
from robbie_robots.workers.speech.order_grammar import (
    OrderGrammar,
    SpokenWords,
    WrongGrammar,
    is_sayable,
    words_with,
)
from robbie_robots.workers.speech.order_recognizer import (
    MAX_DISTANCE,
    RATE_HZ,
    OrderRecognizer,
    SpeechPackagesMissing,
)
from robbie_robots.workers.speech.utterances import UtteranceFinder, silero
from robbie_robots.workers.speech.voice import NoVoice, speak

PCM = "pcm-s16"
OBJECT = "object"
"""The place of sentences for the names of objects."""
TAUGHT = "objects"
"""The topic on which the names of taught objects are published."""
ECHO_S = 0.3
"""How long the robot's voice may still be heard in a room after the loudspeaker has ended."""
ANSWERS = OrderGrammar(
    {
        "yes": ["yes [please]", "yeah", "that's right", "correct"],
        "no": ["no [thanks]", "nope", "wrong", "cancel"],
    },
    {},
)


class Hearing(StrEnum):
    """What the robot waits for."""

    ORDER = "waits for an order"
    ANSWER = "waits for yes or no"


class SpokenOrders(Module):
    """Understands orders of a grammar in the sound of a microphone; publishes `SpokenOrder`.

    Subscribes to `RawAudio`: of the microphone (16 kHz, 16 bits), and of the loudspeaker, because it must not
    listen to the robot's own voice. Publishes `Say` to ask whether it has understood an order of `confirm`.
    What is not in the grammar is refused and counted. Objects that people have taught (`TaughtNames`) can be
    said for <object>, too, if the dictionary knows their words.
    """

    orders: dict[str, list[str]] = setting(
        REQUIRED, 'names of orders, each with its sentences, such as "bring me [the] <object>"'
    )
    words: dict[str, list[str]] = setting({}, "what can be said at each <place> of a sentence")
    pronunciations: dict[str, str] = setting(
        {}, 'of words that are in no dictionary, such as {robbie: "R AA B IY"}'
    )
    confirm: list[str] = setting([], "orders that count only when the person has said yes")
    microphone: str = setting("microphone", "topic of the microphone")
    loudspeaker: str = setting("loudspeaker", "topic of the loudspeaker")
    max_distance: float = setting(
        MAX_DISTANCE,
        "utterances that sound less like an order are refused: 0 (none is accepted) to 1",
        minimum=0.0,
        maximum=1.0,
        changeable=True,
    )
    answer_s: float = setting(8.0, "how long the robot waits for yes or no", minimum=1.0, maximum=60.0)
    period_s: float = setting(0.1, "time between looks at the clock", minimum=0.01)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the grammar, so that a mistake in it is reported before anything starts."""
        orders, words, confirm = settings["orders"], settings["words"], settings["confirm"]
        assert isinstance(orders, dict) and isinstance(words, dict) and isinstance(confirm, list)
        try:
            OrderGrammar(orders, words)
        except WrongGrammar as error:
            raise SettingError(str(error), "orders") from error
        if unknown := sorted(set(confirm) - set(orders)):
            raise SettingError(f"confirm: there is no order {', '.join(unknown)}", "confirm")

    def setup(self) -> None:
        """Load the models."""
        grammars = {"orders": OrderGrammar(self.orders, self.words), "answers": ANSWERS}
        try:
            self.recognizer = OrderRecognizer(grammars, self.pronunciations, self.max_distance)
            self.utterances = UtteranceFinder(silero())
        except (WrongGrammar, GrammarTooLarge) as error:
            raise SettingError(str(error), "orders") from error
        except SpeechPackagesMissing as error:
            raise SettingError(str(error)) from error
        self.asked: SpokenOrder | None = None
        self.accepted = self.refused = self.wrong_format = 0
        self.deaf_until_s = 0.0
        self.machine = StateMachine(
            Hearing.ORDER,
            {Hearing.ORDER: {Hearing.ANSWER}, Hearing.ANSWER: {Hearing.ORDER}},
            clock=self.monotonic_s,
            time_outs={Hearing.ANSWER: TimeOut(self.answer_s, Hearing.ORDER)},
            on_change=self.show_state,
        )
        self.show_state(Hearing.ORDER)
        self.advertise(SpokenOrder)
        self.advertise(Say)
        self.subscribe(RawAudio, self.on_microphone, topic=self.microphone)
        self.subscribe(RawAudio, self.on_loudspeaker, topic=self.loudspeaker, optional=True)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(TaughtNames, self.on_taught, newest, topic=TAUGHT, optional=True)

    def on_loudspeaker(self, audio: RawAudio) -> None:
        """Do not listen while the robot speaks."""
        if audio.sample_rate and audio.number_of_channels:
            length_s = audio.data.size / (2 * audio.sample_rate * audio.number_of_channels)
            self.deaf_until_s = max(self.deaf_until_s, self.monotonic_s()) + length_s
            self.utterances.forget()

    def on_taught(self, taught: TaughtNames) -> None:
        """Understand the names of the objects that people have taught, and no longer of forgotten ones."""
        can_pronounce = self.recognizer.can_pronounce
        names = [name for name in taught.names if is_sayable(name) and can_pronounce(name)]
        if unknown := [name for name in taught.names if name not in names]:
            self.log.info("does not understand these names: %s", ", ".join(unknown))
        grammar = OrderGrammar(self.orders, words_with(self.words, OBJECT, names))
        try:
            self.recognizer.use("orders", grammar)
        except GrammarTooLarge as error:
            self.log.error("does not understand what was taught: %s", error)

    def on_microphone(self, audio: RawAudio) -> None:
        """Listen to a block."""
        channels = audio.number_of_channels
        if (
            audio.format != PCM
            or audio.sample_rate != RATE_HZ
            or not channels
            or audio.data.size % (2 * channels)
        ):
            self._refuse_format(audio)
        elif self.monotonic_s() > self.deaf_until_s + ECHO_S:
            samples = np.frombuffer(audio.data.tobytes(), "<i2").reshape(-1, channels)
            for utterance in self.utterances.add(np.ascontiguousarray(samples[:, 0])):
                self._understand(utterance)

    def tick(self) -> None:
        """Stop waiting for an answer, in time."""
        if not self.utterances.hears_speech and self.machine.expire():
            self.asked = None
            self._say("I heard no answer, so I do nothing.")
        self.status = (
            f"{self.accepted} orders, {self.refused} refused, {self.utterances.too_short} too short, "
            f"{self.utterances.too_long} too long, {self.wrong_format} blocks of a wrong format"
        )

    def teardown(self) -> None:
        """Let go of the models."""
        self.recognizer.close()

    def _understand(self, utterance: NDArray[np.int16]) -> None:
        self.recognizer.max_distance = self.max_distance  # changeable
        if self.machine.state is Hearing.ANSWER:
            self._take_answer(utterance)
            return
        heard = self.recognizer.recognize(utterance, "orders")
        if heard.order is None:
            self.refused += 1
            self.log.info(
                'refused "%s", heard as "%s": %.2f apart', heard.nearest, heard.transcript, heard.distance
            )
            return
        order = self._message(heard.order, heard.distance)
        if order.order in self.confirm:
            self.asked = order
            self.machine.go(Hearing.ANSWER, order.text)
            self._say(f"Did you say: {order.text}?")
        else:
            self._accept(order)

    def _take_answer(self, utterance: NDArray[np.int16]) -> None:
        asked, heard = self.asked, self.recognizer.recognize(utterance, "answers")
        assert asked is not None
        if heard.order is None:
            self.refused += 1
            self._say("Please say yes or no.")
            return
        self.asked = None
        self.machine.go(Hearing.ORDER, heard.order.text)
        if heard.order.order == "yes":
            self._accept(replace(asked, was_confirmed=True))
        else:
            self._say("Then I do nothing.")

    def _accept(self, order: SpokenOrder) -> None:
        self.accepted += 1
        self.log.info('understood "%s" (%s)', order.text, order.order)
        self.publish(order)

    def _message(self, words: SpokenWords, distance: float) -> SpokenOrder:
        return SpokenOrder(
            header=Header(stamp=self.now()),
            order=words.order,
            text=words.text,
            slots=[SpokenSlot(name=name, words=said) for name, said in words.slots.items()],
            distance=distance,
        )

    def _refuse_format(self, audio: RawAudio) -> None:
        self.wrong_format += 1
        if self.wrong_format == 1:
            self.log.error(
                "refused sound from %s: %s, %d Hz, %d channels, %d bytes; this understands %s at %d Hz",
                self.envelope.sender,
                audio.format,
                audio.sample_rate,
                audio.number_of_channels,
                audio.data.size,
                PCM,
                RATE_HZ,
            )

    def _say(self, text: str) -> None:
        self.publish(Say(text=text))


class Voice(Module):
    """Speaks the texts of `Say`: publishes `RawAudio` on the loudspeaker's topic, no faster than it plays."""

    loudspeaker: str = setting("loudspeaker", "topic of the loudspeaker")
    rate_hz: int = setting(16_000, "samples each second", minimum=8_000, maximum=48_000)
    voice: str = setting("en-us", "one of `espeak-ng --voices`")
    words_per_minute: int = setting(150, "how fast it speaks", minimum=80, maximum=300)
    max_waiting: int = setting(
        8, "texts that may wait; the oldest is dropped beyond that", minimum=1, maximum=100
    )
    period_s: float = setting(0.05, "time between blocks of sound", minimum=0.01, maximum=0.5)

    # How far the sound that was sent may be ahead of what the loudspeaker has played.
    AHEAD_S = 0.2

    def setup(self) -> None:
        """Try the voice."""
        try:
            speak("hello", self.rate_hz, self.voice, self.words_per_minute)
        except NoVoice as error:
            raise SettingError(str(error), "voice") from error
        self.waiting: deque[str] = deque()
        self.sound: NDArray[np.int16] = np.zeros(0, np.int16)
        self.played_until_s = 0.0
        self.spoken = self.dropped = self.failed = 0
        self.advertise(RawAudio, topic=self.loudspeaker)
        self.subscribe(Say, self.on_say, optional=True)

    def on_say(self, say: Say) -> None:
        """Have a text wait for its turn."""
        if say.text.strip():
            self.waiting.append(say.text)
        if len(self.waiting) > self.max_waiting:
            self.log.warning('dropped "%s": %d texts wait', self.waiting.popleft(), self.max_waiting)
            self.dropped += 1

    def tick(self) -> None:
        """Publish the next sound."""
        if not self.sound.size and self.waiting:
            self._begin(self.waiting.popleft())
        now_s = self.monotonic_s()
        self.played_until_s = max(self.played_until_s, now_s)
        count = round((now_s + self.AHEAD_S - self.played_until_s) * self.rate_hz)
        if self.sound.size and count > 0:
            block, self.sound = self.sound[:count], self.sound[count:]
            self.played_until_s += len(block) / self.rate_hz
            self.publish(self._message(block), topic=self.loudspeaker)
        self.status = (
            f"{self.spoken} texts, {len(self.waiting)} wait, {self.dropped} dropped, {self.failed} failed"
        )

    def _begin(self, text: str) -> None:
        try:
            self.sound = speak(text, self.rate_hz, self.voice, self.words_per_minute)
        except NoVoice as error:
            self.failed += 1
            self.log.error('could not speak "%s": %s', text, error)
            return
        self.spoken += 1
        self.log.info('says "%s"', text)

    def _message(self, block: NDArray[np.int16]) -> RawAudio:
        return RawAudio(
            timestamp=self.now(),
            data=np.frombuffer(block.astype("<i2").tobytes(), np.uint8),
            format=PCM,
            sample_rate=self.rate_hz,
            number_of_channels=1,
        )
