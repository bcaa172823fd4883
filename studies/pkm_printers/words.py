"""Words of a machine's files: each is read, left out at a stated cost, or refused.

A word is a letter of a command (`M665 B`) or an option of a section (`[printer]
delta_radius`). Each firmware has a table of the words that it documents; a word of a
group in the table that the table lacks is refused, as it may be part of the geometry.
"""

import dataclasses
import enum
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping

from pkm_studies.base import InputError

#: stands for a number in a key of a table: `height<n>` is height0, height1, ...
NUMBER = "<n>"
#: key of a table for all words that it does not name: such a group refuses none
OTHERS = "*"
COMMENT_COLUMNS = 100  #: columns of a comment in a study
UNKNOWN = "this importer does not know this word, which may be part of the geometry"
UNKNOWN_REMEDY = (
    "remove it from a copy of the file where it is no part of the geometry; otherwise"
    " describe the machine by a study of your own"
)


class Use(enum.Enum):
    """What an importer does with a word."""

    READ = "read"
    NOT_READ = "not read"
    REFUSED = "refused"


@dataclasses.dataclass(frozen=True, slots=True)
class Word:
    """A word as an importer treats it."""

    use: Use
    #: of a word not read: what that may cost, "" for one that is no part of the
    #: geometry; of a refused one: why
    about: str = ""
    remedy: str = ""  #: of a refused word


READ = Word(Use.READ)
HARMLESS = Word(Use.NOT_READ)
#: words by key, by group: a command, or a section in brackets
WordTable = Mapping[str, Mapping[str, Word]]


def costs(about: str) -> Word:
    """A word that is not read, with what that may cost."""
    return Word(Use.NOT_READ, about)


def refused(problem: str, remedy: str) -> Word:
    """A word that is refused, with why and what to do."""
    return Word(Use.REFUSED, problem, remedy)


def same(word: Word, keys: Iterable[str]) -> dict[str, Word]:
    """A part of a table: these keys, treated alike."""
    return dict.fromkeys(keys, word)


def options(names: str) -> list[str]:
    """Names of options that stand in one text, with spaces between."""
    return names.split()


@dataclasses.dataclass(frozen=True)
class WrittenWord:
    """A word as a file has it."""

    group: str  #: command, or section in brackets
    key: str  #: letter, or option
    text: str  #: as written
    line: int  #: of the file, from 1
    #: makes the error about it, from problem and remedy
    error: Callable[[str, str], InputError]


def account(
    written: Iterable[WrittenWord], others: Iterable[str], table: WordTable
) -> list[str]:
    """Sentences on what becomes of each word. Raises InputError for unknown ones.

    others  groups, those that the table lacks among them
    """
    read: dict[str, list[str]] = {}
    harmless: dict[str, list[str]] = {}
    costly: dict[str, dict[str, int]] = {}
    for one in written:
        key, word = _entry(one, table)
        if word.use is Use.REFUSED:
            raise one.error(word.about, word.remedy)
        if word.use is Use.NOT_READ and word.about:
            name = f"{one.group} {key}".rstrip()
            costly.setdefault(word.about, {})[name] = one.line
            continue
        keys = (read if word.use is Use.READ else harmless).setdefault(one.group, [])
        if key not in keys:
            keys.append(key)
    unknown = []
    for group in dict.fromkeys(others):
        if group not in table:
            unknown.append(group)
        elif not table[group]:
            harmless.setdefault(group, [])
    sentences = [f"Words read: {_listed(read)}."] if read else []
    sentences += [cost_sentence(places, about) for about, places in costly.items()]
    if harmless:
        sentences.append(f"Not read, no part of the geometry: {_listed(harmless)}.")
    if unknown:
        listed = ", ".join(unknown)
        sentences.append(f"Not read, taken for no part of the geometry: {listed}.")
    return sentences


def cost_sentence(places: Mapping[str, int], about: str) -> str:
    """A sentence on words that are not read, with their lines, and what that may cost."""
    named = ", ".join(f"{name} (line {line})" for name, line in places.items())
    return f"Not read: {named}: {about}."


def comments(sentences: Iterable[str]) -> str:
    """Sentences as comments of a study, one after the other."""
    lines = []
    for sentence in sentences:
        lines += textwrap.wrap(
            sentence, COMMENT_COLUMNS, initial_indent="# ", subsequent_indent="#   "
        )
    return "".join(f"{line}\n" for line in lines)


def _entry(one: WrittenWord, table: WordTable) -> tuple[str, Word]:
    """The key of a word in the table, and how it is treated. Raises InputError."""
    keys = table[one.group]
    if one.key in keys:
        return one.key, keys[one.key]
    general = re.sub(r"\d+", NUMBER, one.key, count=1)
    if general in keys:
        return general, keys[general]
    if OTHERS in keys:
        return one.key, keys[OTHERS]
    raise one.error(UNKNOWN, UNKNOWN_REMEDY)


def _listed(words: Mapping[str, list[str]]) -> str:
    """Groups with their keys; those with the same keys together."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for group, keys in words.items():
        alike.setdefault(tuple(sorted(keys)), []).append(group)
    parts = []
    for groups in alike.values():
        text = " ".join(words[groups[0]])
        parts.append(f"{', '.join(groups)} {text}".rstrip())
    return "; ".join(parts)
