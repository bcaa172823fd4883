"""What became of the options of a Klipper configuration."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

from pkm_studies.base.errors import InputError
from pkm_studies.importers.klipper_config import Entry, KlipperConfig
from pkm_studies.importers.klipper_words import COSTLY_SECTIONS, WORDS
from pkm_studies.importers.words import WrittenWord, account, cost_sentence

INCLUDE = "include "
INCLUDED = (
    "their options win over those above them; give these files too where they have any of"
    " [printer], [stepper_*] or [delta_calibrate]"
)


def config_account(config: KlipperConfig, files: Sequence[Path]) -> list[str]:
    """Sentences on the options read and not read. Raises InputError.

    files  that were given
    """
    plain = [_group(name) for name in config.sections if _is_plain(name)]
    words = account(_written(config), plain, WORDS)
    return [*words.sentences(), *_costly(config), *_included(config, files)]


def _is_plain(name: str) -> bool:
    """Whether nothing more is to be said of a section that is not read."""
    return _kind(name) not in COSTLY_SECTIONS and not name.startswith(INCLUDE)


def _group(name: str) -> str:
    """A section in brackets; all of one kind alike where none of them is read."""
    group = f"[{name.lower()}]"
    return group if group in WORDS else f"[{_kind(name)}]"


def _kind(name: str) -> str:
    """The kind of a section: `bed_mesh` of `bed_mesh default`."""
    return name.lower().partition(" ")[0]


def _written(config: KlipperConfig) -> Iterator[WrittenWord]:
    """The options of the sections that bear on the delta and its probe."""
    for (section, key), entry in config.entries.items():
        group = f"[{section}]"
        if group in WORDS:
            error = functools.partial(_error, entry, f"{group} {key}")
            yield WrittenWord(group, key, entry.text, entry.line, error)


def _error(entry: Entry, option: str, problem: str, remedy: str) -> InputError:
    return entry.error(option, problem, remedy)


def _costly(config: KlipperConfig) -> list[str]:
    """Sentences on sections that move the tool in other ways than the geometry."""
    alike: dict[str, dict[str, int]] = {}
    for section, line in config.sections.items():
        about = COSTLY_SECTIONS.get(_kind(section))
        if about is not None:
            alike.setdefault(about, {}).setdefault(f"[{_kind(section)}]", line)
    return [cost_sentence(places, about) for about, places in alike.items()]


def _included(config: KlipperConfig, files: Sequence[Path]) -> list[str]:
    """A sentence on files that the configuration includes and that were not given."""
    given = {path.name for path in files}
    places = {
        f"[{section}]": line
        for section, line in config.sections.items()
        if section.startswith(INCLUDE)
        and Path(section.removeprefix(INCLUDE).strip()).name not in given
    }
    return [cost_sentence(places, INCLUDED)] if places else []
