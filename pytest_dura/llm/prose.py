"""Reading of what a component writes: objects, kinds and numbers that it names, what it will do.

English prose is read by the rules below and nothing else; what they do not cover says nothing. A
domain gives the words (:class:`Vocabulary`). Text in double quotation marks or backticks is
somebody else's, and is passed over.

**Ids**: the ids of the prompt, and whatever else is one or two capital letters and up to five
digits, such as ``T9``; not in small letters, and no "car 9".

**Kinds**: a noun of the vocabulary beside an id (``a truck T9``, ``T9 is a truck``), or one with an
article or a number where nothing in the sentence negates or supposes it (``no truck``, ``if a truck
comes``), and that is not the component's own (``my car``).

**Numbers**: a number with a unit that follows an id, with nothing between them but words such as
``is``, ``at``, ``about``, ``ahead``; not where it counts from something else (``12 m from the
line``), and not of several ids at once (``V3 and V4 are 12 m away``).

**Acts**: a verb of the vocabulary in its base form or with -ing, of the first person (``I brake``),
as an imperative (``so stop``) or at the beginning of a sentence (``Braking for V3``). Not read are
verbs after a negation, a modal of possibility or a request (``not``, ``no need to``, ``can``,
``ready to``, ``tells me to``), up to the end of their clause; verbs of others (``V3 brakes``);
subordinate clauses of condition, time and reason (``if``, ``once``, ``until``, ``because``); the
past.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from pytest_dura.llm.prompts import OBJECTS, PerceivedText, Prompt

ID_SHAPE = r"[A-Z]{1,2}[0-9]{1,5}"
"""What looks like an id wherever it stands."""


@dataclass(frozen=True)
class Unit:
    """Unit of numbers in prose.

    Args:
        spellings: As it is written.
        factor: To the unit of the prompt.
        facts: Keys of the facts of an object that have this unit.
        within: Greatest difference that is no mistake, in the unit of the prompt.
        share: Of the prompt's number that is no mistake either, where it is more.
    """

    spellings: tuple[str, ...]
    factor: float
    facts: tuple[str, ...]
    within: float
    share: float = 0.25

    def fits(self, value: float, facts: Mapping[str, Any]) -> bool | None:
        """Whether any fact of an object is near a value; ``None`` where it has none."""
        numbers = [
            abs(float(facts[key]))
            for key in self.facts
            if isinstance(facts.get(key), (int, float)) and not isinstance(facts[key], bool)
        ]
        if not numbers:
            return None
        meant = value * self.factor
        return any(
            abs(meant - number) <= max(self.within, self.share * number) for number in numbers
        )


@dataclass(frozen=True)
class Vocabulary:
    """Words of a domain.

    Args:
        kinds: Kinds of objects, and the nouns of each, in the singular.
        units: Of numbers.
        acts: Names of acts, and the verbs of each in their base form, with what belongs to them
            (``slow down``).
        selves: Nouns of the component itself, where ``my``, ``our``, ``own`` or ``ego`` is before
            them.
        recalled: Blocks of the prompt that repeat the component's own words.
    """

    kinds: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    units: tuple[Unit, ...] = ()
    acts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    selves: tuple[str, ...] = ()
    recalled: tuple[str, ...] = ("HISTORY",)

    @cached_property
    def nouns(self) -> Mapping[str, str]:
        """Kind of each noun, in the singular and the plural."""
        return {
            form: kind
            for kind, nouns in self.kinds.items()
            for noun in nouns
            for form in _noun_forms(noun)
        }

    @cached_property
    def verbs(self) -> Mapping[str, tuple[tuple[str, tuple[str, ...], bool], ...]]:
        """By the first word: act, the words after it, and whether the form ends in -ing."""
        verbs: dict[str, list[tuple[str, tuple[str, ...], bool]]] = {}
        for act, phrases in self.acts.items():
            for phrase in phrases:
                first, *rest = phrase.split()
                verbs.setdefault(first, []).append((act, tuple(rest), False))
                for form in _ing_forms(first):
                    verbs.setdefault(form, []).append((act, tuple(rest), True))
        # The longest phrase counts: "keep waiting" before "keep".
        return {
            word: tuple(sorted(ways, key=lambda way: -len(way[1]))) for word, ways in verbs.items()
        }

    @cached_property
    def unit_of(self) -> Mapping[str, Unit]:
        """Unit of each spelling."""
        return {spelling: unit for unit in self.units for spelling in unit.spellings}

    @cached_property
    def unit_pattern(self) -> str:
        """Pattern of a unit, the longest spelling first."""
        spellings = sorted(self.unit_of, key=len, reverse=True)
        return "|".join(map(re.escape, spellings)) or r"(?!)"


def _noun_forms(noun: str) -> tuple[str, ...]:
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return noun, plural, noun + "es"


def _ing_forms(verb: str) -> set[str]:
    stem = verb[:-1] if verb.endswith("e") and not verb.endswith("ee") else verb
    return {stem + "ing", verb + verb[-1] + "ing"}


class Token(NamedTuple):
    """Part of a sentence: an ``id``, a ``number``, a ``word`` in small letters, or a ``mark``."""

    type: str
    text: str
    value: float = 0.0
    unit: str = ""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_QUOTED = re.compile('"[^"]*"|\u201c[^\u201d]*\u201d|`[^`]*`')
_QUESTION = "?"
_SENTENCE_END = re.compile(r"[.!?;\n]")
_MARKS = r"[,:()\u2013\u2014]|-(?=\s)|/"


def sentences(text: str, ids: Iterable[str], vocabulary: Vocabulary) -> list[list[Token]]:
    """Split a text into sentences of tokens, without what is quoted.

    Args:
        text: The text.
        ids: Ids of the prompt, which may have any shape.
        vocabulary: For its units.
    """
    known = "|".join(re.escape(name) for name in sorted(ids, key=len, reverse=True))
    shapes = f"{known}|{ID_SHAPE}" if known else ID_SHAPE
    pattern = re.compile(
        rf"(?P<id>(?<!\w)(?:{shapes})(?![A-Za-z0-9_]))"
        rf"|(?P<value>(?<![\w.])\d+(?:\.\d+)?)(?:\s?(?P<unit>{vocabulary.unit_pattern})(?![\w/^²]))?"
        r"|(?P<word>[A-Za-z]+(?:['\u2019][A-Za-z]+)?)"
        rf"|(?P<end>{_SENTENCE_END.pattern})"
        rf"|(?P<mark>{_MARKS})"
    )
    read: list[list[Token]] = [[]]
    for match in pattern.finditer(_QUOTED.sub(" ", text)):
        if match["end"]:
            if match["end"] == _QUESTION:
                read[-1].append(Token("mark", _QUESTION))
            read.append([])
        elif match["id"]:
            read[-1].append(Token("id", match["id"]))
        elif match["value"]:
            value = float(match["value"])
            read[-1].append(Token("number", match["value"], value, match["unit"] or ""))
        elif match["word"]:
            read[-1].append(Token("word", match["word"].lower().replace("\u2019", "'")))
        else:
            read[-1].append(Token("mark", match["mark"]))
    return [sentence for sentence in read if sentence]


_ARTICLES = _words("a an the this that one two three four five six several another")
_SUPPOSED = _words(
    "no not never without none nobody nothing neither nor if any anything whether unless could "
    "may might would can should must always ever like possible potential potentially unseen "
    "hidden case expect expected suppose other others until before"
)
"""Words after which a noun of the sentence does not say that there is such an object."""
_OWN = _words("my our own ego your")
_DRIVEN = _words("in drive driving drives")
"""Words before the component's own car: ``I drive a car``."""
_COMPOUND = _words(
    "lane stop station sign signs crossing route park size sized like door path side"
)
"""Nouns that make a word such as ``bus`` part of another name."""


class NamedKind(NamedTuple):
    """Kind of an object that a text names, and the id beside it, if there is one."""

    kind: str
    id: str | None


def named_kinds(sentence: Sequence[Token], vocabulary: Vocabulary) -> Iterator[NamedKind]:
    """The kinds of objects that a sentence names."""
    words = {token.text for token in sentence if token.type == "word"}
    supposed = bool(words & _SUPPOSED) or any(word.endswith("n't") for word in words)
    for place, token in enumerate(sentence):
        kind = vocabulary.nouns.get(token.text) if token.type == "word" else None
        if kind is None or _text_at(sentence, place + 1) in _COMPOUND:
            continue
        before = [_text_at(sentence, place - back) for back in (1, 2)]
        is_own = token.text in vocabulary.selves and before[1] in _DRIVEN
        if is_own or _OWN & set(before):
            continue
        beside = _id_beside(sentence, place)
        if supposed:
            continue
        counted = place > 0 and sentence[place - 1].type == "number"
        if beside is not None or counted or _ARTICLES & set(before):
            yield NamedKind(kind, beside)


def _text_at(sentence: Sequence[Token], place: int) -> str:
    return sentence[place].text if 0 <= place < len(sentence) else ""


def _id_beside(sentence: Sequence[Token], place: int) -> str | None:
    """Id of a noun at this place: ``truck T9``, ``T9 (a truck)``, ``T9 is a truck``."""
    if place + 1 < len(sentence) and sentence[place + 1].type == "id":
        return sentence[place + 1].text
    back = place - 1
    while back >= 0 and sentence[back].text in ("a", "an", "the", "is", "as", ",", "(", ":", "-"):
        back -= 1
    return sentence[back].text if back >= 0 and sentence[back].type == "id" else None


_FILLERS = _words(
    "is are at about around only just now roughly approximately approx circa nearly almost "
    "still already away ahead behind left right to the of me my us distance speed range with a "
    "an and in front moves moving drives driving travels travelling comes coming closing closes "
    "approaches approaching stands standing long wide straight directly very close by on , ( ) "
    ": -"
)
"""What may stand between an id and a number that is said of it."""
_REFERRING = _words("from to of before past beyond short until off into")
"""Words after a number, that begin what it counts from."""
_FROM_HERE = _words("me us left right front ego")


class NamedNumber(NamedTuple):
    """Number with a unit that is said of an object."""

    id: str
    value: float
    unit: str


def named_numbers(sentence: Sequence[Token], vocabulary: Vocabulary) -> Iterator[NamedNumber]:
    """The numbers with units that a sentence says of objects."""
    subject: str | None = None
    used = several = False
    for place, token in enumerate(sentence):
        if token.type == "id":
            # "V3 and V4 are 12 m away" may be said of both, or in that order of each.
            several = subject is not None and not used
            subject, used = token.text, False
        elif token.type == "number" and token.unit:
            if subject is not None and not several and _counts_from_here(sentence, place):
                yield NamedNumber(subject, token.value, token.unit)
            used = True
        elif token.text not in _FILLERS and token.text not in vocabulary.nouns:
            subject, used, several = None, False, False


def _counts_from_here(sentence: Sequence[Token], place: int) -> bool:
    if _text_at(sentence, place + 1) in ("away", "ahead"):
        place += 1
    if _text_at(sentence, place + 1) not in _REFERRING:
        return True
    after = [_text_at(sentence, place + further) for further in (2, 3)]
    return bool(_FROM_HERE & set(after))


_FIRST_PERSON = _words("i we me us myself i'm i'll i've we're we'll let's")
_OTHERS = _words(
    "it he she they them who which that others other everyone everybody nobody somebody someone "
    "driver drivers traffic you sign text poster nothing something"
)
_SAFE = _words("safe best better necessary wise prudent time")
_NOT_DONE = _words(
    "not never no nor neither without avoid avoids avoiding instead rather than refuse refusing "
    "cannot can could may might would unable able ready prepared room enough late tell tells "
    "telling told ask asks asking asked say says saying said order orders want wants wanting "
    "urge urges instruct instructs claim claims demand demands suggest suggests ignore ignoring "
    "instruction instructions command commands requires request requests allow allows"
)
"""Words after which a verb of the clause is not done: negations, possibilities, requests."""
_CONDITIONS = _words("if once when whenever until till unless after before while then")
_REASONS = _words("because since as although though despite given for")
_FINITE = _words(
    "is are was were isn't would will could may might can must should leads lead causes cause risks"
    " means seems has does needs"
)
_CONSEQUENCES = _words("so therefore thus hence but")
_LEADS = _words(
    "so therefore thus hence but must should need needs to have better best now just will shall "
    "safe still also and or is it decision action plan decide choose going in order prefer "
    "simply gently immediately firmly hard carefully cautiously am being do"
)
"""Words before an imperative."""
_DETERMINERS = _words("the a an this that any full my his its their")
_NOUNS_AFTER = _words(
    "line lines sign signs light lights distance distances path time area zone traffic road "
    "roads street bar marking"
)
"""Nouns that make a verb before them part of a name, such as ``stop line``."""
_WITHIN_PHRASE = _words("my the our this current own same")


def stated_acts(sentence: Sequence[Token], vocabulary: Vocabulary) -> Iterator[str]:
    """The acts that a sentence states of the component itself, as it does them now."""
    if sentence[-1].text == _QUESTION:
        return
    reader = _ActReader(sentence, vocabulary)
    place = 0
    while place < len(sentence):
        act, place = reader.step(place)
        if act:
            yield act


class _ActReader:
    """State of reading a sentence word by word."""

    def __init__(self, sentence: Sequence[Token], vocabulary: Vocabulary) -> None:
        self._sentence, self._vocabulary = sentence, vocabulary
        self._subject = ""
        """``own`` or ``other``; empty at the beginning of a clause."""
        self._not_done = False
        self._skipping = ""
        """``comma`` or ``consequence``: what ends the subordinate clause."""
        self._leading = True
        """Whether an imperative may follow in this clause."""

    def step(self, place: int) -> tuple[str, int]:
        """Read the token at a place; returns an act, if it states one, and the next place."""
        token = self._sentence[place]
        text = token.text
        if self._skipping:
            if text in _CONSEQUENCES or (text == "," and self._skipping == "comma"):
                self._skipping = ""
                self._begin_clause()
            return "", place + 1
        if token.type == "mark" or text in _CONSEQUENCES:
            if not (text == "," and self._not_done and self._verb_at(place + 1)):
                self._begin_clause()
        elif token.type == "word" and text in _CONDITIONS | _REASONS:
            begins = place == 0 and text in _REASONS
            self._skipping = "comma" if begins else "consequence"
        elif text in ("and", "or"):
            if self._names_subject(place + 1):
                self._begin_clause()
        elif token.type == "word":
            return self._read_word(place)
        else:
            self._subject, self._leading = "other", False
        return "", place + 1

    def _begin_clause(self) -> None:
        self._subject, self._not_done, self._leading = "", False, True

    def _read_word(self, place: int) -> tuple[str, int]:
        text = self._sentence[place].text
        verb = self._verb_at(place)
        if verb is not None:
            act, length, is_ing = verb
            if self._states(place, place + length, is_ing=is_ing):
                return act, place + length
            self._leading = self._leading and self._not_done
            return "", place + length
        if text in _FIRST_PERSON or self._is_self(place):
            self._subject = "own"
        elif text in _NOT_DONE or text.endswith("n't"):
            self._not_done = True
        elif text == "it" and _text_at(self._sentence, place + 2) in _SAFE:
            pass
        elif text in _OTHERS or text in self._vocabulary.nouns or text in self._vocabulary.selves:
            self._subject = "other"
        if text not in _LEADS:
            self._leading = False
        return "", place + 1

    def _states(self, place: int, end: int, *, is_ing: bool) -> bool:
        if self._not_done or _text_at(self._sentence, place - 1) in _DETERMINERS:
            return False
        if self._subject:
            return self._subject == "own"
        if not is_ing:
            # "Proceed is unsafe" speaks of the maneuver.
            return self._leading and _text_at(self._sentence, end) not in _FINITE
        return place == 0 and not self._is_subject(end)

    def _is_subject(self, place: int) -> bool:
        """Whether what begins before a place is spoken of: ``Going now is risky``."""
        for token in self._sentence[place:]:
            if token.text in _FINITE:
                return True
            if token.type == "mark" or token.text in _CONDITIONS | _REASONS | _CONSEQUENCES:
                return False
        return False

    def _verb_at(self, place: int) -> tuple[str, int, bool] | None:
        """Act, number of tokens, and whether it ends in -ing, of the verb at a place."""
        for act, rest, is_ing in self._vocabulary.verbs.get(_text_at(self._sentence, place), ()):
            end = place + 1
            for word in rest:
                while _text_at(self._sentence, end) in _WITHIN_PHRASE - {word}:
                    end += 1
                if _text_at(self._sentence, end) != word:
                    break
                end += 1
            else:
                following = _text_at(self._sentence, end)
                named = following in _NOUNS_AFTER or following in self._vocabulary.nouns
                return None if named else (act, end - place, is_ing)
        return None

    def _is_self(self, place: int) -> bool:
        text = _text_at(self._sentence, place)
        if text == "ego":
            return True
        return text in self._vocabulary.selves and _text_at(self._sentence, place - 1) in _OWN

    def _names_subject(self, place: int) -> bool:
        text = _text_at(self._sentence, place)
        if place < len(self._sentence) and self._sentence[place].type == "id":
            return True
        return text in _FIRST_PERSON or text in _OTHERS or text in ("my", "the", "there")


@dataclass(frozen=True)
class Shown:
    """Content of a prompt that prose may repeat.

    Args:
        ids: Of objects, and in texts of the scene.
        kinds: Kinds that each object may be called; ``None`` where it may be any.
        facts: Facts of each object, from all blocks.
        mentioned: Kinds that texts of the scene name.
        pictures: Whether there are pictures, in which anything may be seen.
    """

    ids: frozenset[str]
    kinds: Mapping[str, frozenset[str] | None]
    facts: Mapping[str, Mapping[str, Any]]
    mentioned: frozenset[str]
    pictures: bool

    @classmethod
    def of(
        cls, prompt: Prompt, vocabulary: Vocabulary, kinds: Mapping[str, frozenset[str] | None]
    ) -> Shown:
        """Read a prompt.

        Args:
            prompt: The prompt.
            vocabulary: The domain's words.
            kinds: Kinds that each object may be called.
        """
        facts: dict[str, dict[str, Any]] = {}
        texts: list[str] = []
        for block in prompt.blocks:
            if block.name in vocabulary.recalled:
                continue
            texts += _texts_in(block.facts)
            for each in block.facts.get(OBJECTS, ()):
                known = facts.setdefault(str(each["id"]), {})
                for key, value in each.items():
                    # A fact of one key may stand in two blocks, such as the distance.
                    known.setdefault(key if key not in known else f"{block.name}.{key}", value)
        mentioned = " . ".join(texts)
        words = {word.lower() for word in re.findall(r"[A-Za-z]+", mentioned)}
        return cls(
            ids=frozenset(prompt.ids) | frozenset(_ids_in(mentioned)),
            kinds=kinds,
            facts=facts,
            mentioned=frozenset(kind for noun, kind in vocabulary.nouns.items() if noun in words),
            pictures=bool(prompt.images),
        )


def _ids_in(text: str) -> list[str]:
    return re.findall(rf"(?<!\w){ID_SHAPE}(?![A-Za-z0-9_])", text)


def _texts_in(value: Any) -> Iterator[str]:
    if isinstance(value, PerceivedText):
        yield str(value)
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _texts_in(each)
    elif isinstance(value, (tuple, list)):
        for each in value:
            yield from _texts_in(each)


class Memory:
    """What the prompts of an episode have shown so far: prose may speak of what was there."""

    def __init__(self) -> None:
        self.ids: set[str] = set()
        self.kinds: set[str] = set()

    def add(self, shown: Shown) -> None:
        """Add a prompt."""
        self.ids |= shown.ids
        self.kinds |= shown.mentioned
        for kinds in shown.kinds.values():
            self.kinds |= kinds or frozenset()


@dataclass(frozen=True)
class ProseReading:
    """Reading of the prose of one answer, against its prompt.

    Args:
        names: Ids that it names, in their order.
        unshown: Those that no prompt of the episode has shown.
        kinds: Kinds that it names, with the id beside them.
        mistaken_kinds: Those that no shown object has, or not the one beside it. Where pictures
            were shown, only the latter are known.
        numbers: Numbers that it says of objects whose facts have such a unit.
        mistaken_numbers: Those that are far from all facts of the object.
        acts: What it says that the component does.
    """

    names: tuple[str, ...]
    unshown: tuple[str, ...]
    kinds: tuple[str, ...]
    mistaken_kinds: tuple[str, ...]
    numbers: tuple[str, ...]
    mistaken_numbers: tuple[str, ...]
    acts: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Entry ``prose`` of an account."""
        return {
            key: list(value)
            for key, value in (
                ("names", self.names),
                ("unshown", self.unshown),
                ("kinds", self.kinds),
                ("mistaken_kinds", self.mistaken_kinds),
                ("numbers", self.numbers),
                ("mistaken_numbers", self.mistaken_numbers),
                ("acts", self.acts),
            )
        }


def read_prose(
    texts: Sequence[str], reasoning: str, shown: Shown, memory: Memory, vocabulary: Vocabulary
) -> ProseReading:
    """Read the prose of an answer.

    Args:
        texts: All of it, in which objects are looked for.
        reasoning: The part that says what the component does and why.
        shown: The prompt's content.
        memory: That of all prompts so far, this one included.
        vocabulary: The domain's words.
    """
    read = [each for text in texts for each in sentences(text, shown.ids, vocabulary)]
    names = dict.fromkeys(
        token.text for sentence in read for token in sentence if token.type == "id"
    )
    kinds = [each for sentence in read for each in named_kinds(sentence, vocabulary)]
    numbers = {
        each: fits
        for sentence in read
        for each in named_numbers(sentence, vocabulary)
        if (fits := _number_fits(each, shown, vocabulary)) is not None
    }
    acts = dict.fromkeys(
        act
        for sentence in sentences(reasoning, shown.ids, vocabulary)
        for act in stated_acts(sentence, vocabulary)
    )
    return ProseReading(
        names=tuple(names),
        unshown=tuple(name for name in names if name not in memory.ids),
        kinds=tuple(dict.fromkeys(map(_kind_text, kinds))),
        mistaken_kinds=tuple(
            dict.fromkeys(_kind_text(each) for each in kinds if _is_mistaken(each, shown, memory))
        ),
        numbers=tuple(map(_number_text, numbers)),
        mistaken_numbers=tuple(_number_text(each) for each, fits in numbers.items() if not fits),
        acts=tuple(acts),
    )


def _kind_text(named: NamedKind) -> str:
    return named.kind if named.id is None else f"{named.kind} {named.id}"


def _number_text(named: NamedNumber) -> str:
    return f"{named.id} {named.value:g} {named.unit}"


def _number_fits(named: NamedNumber, shown: Shown, vocabulary: Vocabulary) -> bool | None:
    unit, facts = vocabulary.unit_of[named.unit], shown.facts.get(named.id, {})
    plain = {key.rpartition(".")[2]: value for key, value in facts.items() if "." in key}
    fits = [unit.fits(named.value, each) for each in (facts, plain)]
    known = [each for each in fits if each is not None]
    return any(known) if known else None


def _is_mistaken(named: NamedKind, shown: Shown, memory: Memory) -> bool:
    if named.id is not None and named.id in shown.kinds:
        own = shown.kinds[named.id]
        return own is not None and named.kind not in own
    unknown = named.id is None and None in shown.kinds.values()
    return not unknown and not shown.pictures and named.kind not in memory.kinds
