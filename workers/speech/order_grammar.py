"""A grammar of spoken orders: sentences with places for words, as a profile lists them."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

ORDER_NAME = re.compile(r"[a-z][a-z0-9_]*")
WORD = re.compile(r"[a-z]+(?:'[a-z]+)*")
TOKEN = re.compile(r"\s*([\[\]()|]|<[a-z][a-z0-9_]*>|[^\s\[\]()|<>]+|.)")
MAX_SENTENCES = 200
"""Templates of a grammar; more would not be told apart by ear."""
MAX_CHOICES = 200
"""Choices for one place."""
MAX_DEPTH = 8
"""Brackets within brackets."""


class WrongGrammar(ValueError):
    """A sentence or a list of words of the grammar cannot be used.

    Example:
        The sentence "bring me the <object" of the order "bring": a "<" without its ">".
    """


@dataclass(frozen=True)
class SpokenWords:
    """An order that was recognised in words.

    Attributes:
        order: its name in the grammar.
        text: the words.
        slots: what was said at each place, such as {"object": "red cup"}.
    """

    order: str
    text: str
    slots: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Word:
    """One word."""

    text: str


@dataclass(frozen=True)
class PhraseRow:
    """Parts that are said one after another."""

    parts: tuple["Part", ...]


@dataclass(frozen=True)
class PhraseChoice:
    """Parts of which one is said."""

    parts: tuple["Part", ...]


@dataclass(frozen=True)
class Optional:
    """A part that may be left out."""

    part: "Part"


@dataclass(frozen=True)
class WordSlot:
    """A place for one of the words of a list."""

    name: str
    choices: tuple[str, ...]


Part = Word | PhraseRow | PhraseChoice | Optional | WordSlot


class OrderGrammar:
    """Which orders can be spoken.

    Args:
        orders: for each order's name its sentences. In a sentence, `[the]` may be left out, `(cup | mug)` is
            a choice, and `<object>` is a place for any of the words of that name, once for each name.
        words: for each place the words that fit, such as {"object": ["cup", "orange juice"]}.

    Raises:
        WrongGrammar: says which sentence or word is wrong, and why.

    Example:
        grammar = OrderGrammar({"bring": ["bring me [the] <object>"]}, {"object": ["cup", "orange juice"]})
        grammar.parse("bring me orange juice").slots  # {"object": "orange juice"}
    """

    def __init__(self, orders: Mapping[str, Sequence[str]], words: Mapping[str, Sequence[str]]) -> None:
        if not orders:
            raise WrongGrammar("the grammar has no order; write at least one, with a sentence")
        self._words = {name: _checked_words(name, choices) for name, choices in words.items()}
        self.sentences: list[tuple[str, Part]] = []
        """For each sentence its order and what it consists of."""
        for order, sentences in orders.items():
            if not ORDER_NAME.fullmatch(order):
                raise WrongGrammar(f'the order "{order}" needs a name such as "bring_here"')
            if not sentences:
                raise WrongGrammar(f'the order "{order}" has no sentence')
            for sentence in sentences:
                self.sentences.append((order, _SentenceReader(order, sentence, self._words).read()))
        if len(self.sentences) > MAX_SENTENCES:
            raise WrongGrammar(
                f"the grammar has {len(self.sentences)} sentences; at most {MAX_SENTENCES} fit"
            )
        self._patterns = [(order, re.compile(_pattern(part))) for order, part in self.sentences]

    @property
    def jsgf(self) -> str:
        """Return the grammar in the JSpeech Grammar Format (W3C note, 2000)."""
        rules = [f"<{name}> = {' | '.join(choices)};" for name, choices in sorted(self._words.items())]
        sentences = " | ".join(f"({_jsgf(part)})" for _, part in self.sentences)
        return "\n".join(["#JSGF V1.0;", "grammar orders;", f"public <order> = {sentences};", *rules, ""])

    @property
    def vocabulary(self) -> frozenset[str]:
        """Return every word that occurs."""
        return frozenset(word for _, part in self.sentences for word in _words(part))

    def parse(self, text: str) -> SpokenWords | None:
        """Return the order that these words give, or None."""
        words = spoken(text)
        for order, pattern in self._patterns:
            # Each word of a pattern is followed by its space.
            if found := pattern.fullmatch(f"{words} "):
                slots = {name: said.strip() for name, said in found.groupdict().items() if said}
                return SpokenWords(order, words, slots)
        return None


def _jsgf(part: Part) -> str:
    match part:
        case Word(text):
            return text
        case PhraseRow(parts):
            return " ".join(map(_jsgf, parts))
        case PhraseChoice(parts):
            return f"({' | '.join(map(_jsgf, parts))})"
        case Optional(inner):
            return f"[{_jsgf(inner)}]"
        case WordSlot(name):
            return f"<{name}>"


def _pattern(part: Part) -> str:
    match part:
        case Word(text):
            return re.escape(text) + " "
        case PhraseRow(parts):
            return "".join(map(_pattern, parts))
        case PhraseChoice(parts):
            return f"(?:{'|'.join(map(_pattern, parts))})"
        case Optional(inner):
            return f"(?:{_pattern(inner)})?"
        case WordSlot(name, choices):
            return f"(?P<{name}>{'|'.join(re.escape(choice) + ' ' for choice in choices)})"


def _words(part: Part) -> Iterator[str]:
    match part:
        case Word(text):
            yield text
        case PhraseRow(parts) | PhraseChoice(parts):
            for each in parts:
                yield from _words(each)
        case Optional(inner):
            yield from _words(inner)
        case WordSlot(_, choices):
            for choice in choices:
                yield from choice.split()


class _SentenceReader:
    """Reads one sentence by recursive descent."""

    def __init__(self, order: str, sentence: str, words: Mapping[str, Sequence[str]]) -> None:
        self._where = f'the sentence "{sentence}" of the order "{order}"'
        self._words = words
        self._tokens = TOKEN.findall(sentence.strip().lower())
        self._next = self._depth = 0
        self._slots: set[str] = set()

    def read(self) -> Part:
        """Return what the sentence consists of."""
        part = self._choice()
        if self._next < len(self._tokens):
            raise WrongGrammar(f'{self._where}: a "{self._tokens[self._next]}" that closes nothing')
        if re.fullmatch(_pattern(part), ""):
            raise WrongGrammar(f"{self._where} may be empty; at least one word must be said")
        return part

    def _peek(self) -> str:
        return self._tokens[self._next] if self._next < len(self._tokens) else ""

    def _choice(self) -> Part:
        rows = [self._row()]
        while self._peek() == "|":
            self._next += 1
            rows.append(self._row())
        return rows[0] if len(rows) == 1 else PhraseChoice(tuple(rows))

    def _row(self) -> Part:
        parts = []
        while (token := self._peek()) and token not in "])|":
            self._next += 1
            parts.append(self._part(token))
        if not parts:
            raise WrongGrammar(f"{self._where}: a choice without words")
        return parts[0] if len(parts) == 1 else PhraseRow(tuple(parts))

    def _part(self, token: str) -> Part:
        if token in "[(":
            return self._brackets(token)
        if token.startswith("<") and token.endswith(">") and len(token) > 1:
            return self._slot(token[1:-1])
        if not WORD.fullmatch(token):
            raise WrongGrammar(
                f'{self._where}: "{token}" is no word; use letters, [ ] for what may be left out, '
                "( | ) for choices and <name> for the words of a list"
            )
        return Word(token)

    def _brackets(self, opening: str) -> Part:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise WrongGrammar(f"{self._where}: more than {MAX_DEPTH} brackets within brackets")
        inner, closing = self._choice(), "]" if opening == "[" else ")"
        if self._peek() != closing:
            raise WrongGrammar(f'{self._where}: a "{opening}" without its "{closing}"')
        self._next += 1
        self._depth -= 1
        return Optional(inner) if opening == "[" else inner

    def _slot(self, name: str) -> Part:
        if name not in self._words:
            known = ", ".join(sorted(self._words)) or "none"
            raise WrongGrammar(
                f'{self._where}: there are no words for "<{name}>"; there are lists for: {known}'
            )
        if name in self._slots:
            raise WrongGrammar(f'{self._where} has "<{name}>" twice; give the second list another name')
        self._slots.add(name)
        # The longest first, so that "orange juice" is not read as "orange".
        return WordSlot(name, tuple(sorted(self._words[name], key=len, reverse=True)))


def spoken(choice: str) -> str:
    """Return words as they are compared: lower case, with single spaces."""
    return " ".join(choice.lower().split())


def is_sayable(choice: str) -> bool:
    """Return whether a grammar takes this as words."""
    words = choice.lower().split()
    return bool(words) and all(WORD.fullmatch(word) for word in words)


def words_with(
    words: Mapping[str, Sequence[str]], place: str, more: Iterable[str]
) -> dict[str, Sequence[str]]:
    """Return the words of a grammar with more of them for one place; what is no words is left out.

    Args:
        words: for each place the words that fit.
        place: name of the place, such as "object"; a grammar without it stays as it is.
        more: what else fits there.
    """
    if place not in words:
        return dict(words)
    known = {spoken(choice): choice for choice in words[place]}
    for choice in more:
        if is_sayable(choice) and len(known) < MAX_CHOICES:
            known.setdefault(spoken(choice), choice)
    return {**words, place: list(known.values())}


def _checked_words(name: str, choices: Sequence[str]) -> tuple[str, ...]:
    if not ORDER_NAME.fullmatch(name):
        raise WrongGrammar(f'the list of words "{name}" needs a name such as "object"')
    if not 0 < len(choices) <= MAX_CHOICES:
        raise WrongGrammar(f'the list "{name}" has {len(choices)} words; 1 to {MAX_CHOICES} fit')
    checked = []
    for choice in choices:
        if not is_sayable(str(choice)):
            raise WrongGrammar(f'"{choice}" in the list "{name}" is no word; write it as it is spoken')
        checked.append(spoken(str(choice)))
    return tuple(dict.fromkeys(checked))
