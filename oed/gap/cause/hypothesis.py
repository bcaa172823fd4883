"""Hypotheses of a diagnosis: sets of effects, with or without an unknown remainder."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from oed.base import Array
from oed.gap.data.diagnosis import UNKNOWN
from oed.gap.forms.library import Library

#: prior probabilities: nothing acts, or nothing that the readings show (two of seven
#: sizes of a gap); one effect, two, three, an unknown alone, one or two with an unknown
#: remainder
PRIOR = {
    "none": 0.34,
    "unseen": 0.19,
    "one": 0.17,
    "two": 0.06,
    "three": 0.007,
    "unknown": 0.07,
    "one+": 0.135,
    "two+": 0.028,
}
#: kinds of PRIOR by the number of effects, without and with an unknown remainder
_WITHOUT_UNKNOWN = (("none", "unseen"), ("one",), ("two",), ("three",))
_WITH_UNKNOWN = (("unknown",), ("one+",), ("two+",), ("two+",))

#: what a hypothesis says, whatever its forms: effects, whether an unknown acts
Key = tuple[frozenset[str], bool]


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A set of effects, with or without an unknown remainder, and no more that shows.

    effects         names of the effects
    unknown         whether an unknown remainder acts as well
    atoms           number of each effect's best form in the library
    sizes           size of each effect's best form
    process         number of the best unknown process; None without a remainder
    process_size    size of the best unknown process
    log_evidence    of the readings, over all forms and sizes
    log_prior       log prior probability
    law             number of the noise law that suits it best
    effective_laws  number of equally good noise laws that its evidence rests on
    """

    effects: tuple[str, ...]
    unknown: bool
    atoms: tuple[int, ...]
    sizes: tuple[float, ...]
    process: int | None
    process_size: float
    log_evidence: float
    log_prior: float
    law: int = 0
    effective_laws: float = 1.0

    @property
    def score(self) -> float:
        """Log posterior up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def key(self) -> Key:
        """What it says, whatever its forms."""
        return frozenset(self.effects), self.unknown

    @property
    def names(self) -> tuple[str, ...]:
        """Its effects, and an unknown."""
        return (*self.effects, UNKNOWN) if self.unknown else self.effects

    @property
    def is_gap(self) -> bool:
        """Whether it says that there is a gap."""
        return bool(self.effects) or self.unknown

    def without(self, i: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Forms and sizes of all its effects but the i-th."""
        return self.atoms[:i] + self.atoms[i + 1 :], self.sizes[:i] + self.sizes[
            i + 1 :
        ]

    def with_form(self, part: int, form: int, size: float) -> Hypothesis:
        """The same with another form of one part, an effect or the remainder."""
        if part == len(self.effects):
            return dataclasses.replace(self, process=form, process_size=size)
        atoms, sizes = list(self.atoms), list(self.sizes)
        atoms[part], sizes[part] = form, size
        return dataclasses.replace(self, atoms=tuple(atoms), sizes=tuple(sizes))

    def forms(
        self, library: Library, processes: Library
    ) -> list[tuple[Library, int, float]]:
        """Library, number and size of each of its forms, the remainder's last."""
        pairs = zip(self.atoms, self.sizes, strict=True)
        forms = [(library, atom, size) for atom, size in pairs]
        if self.process is not None:
            forms.append((processes, self.process, self.process_size))
        return forms

    def columns(
        self, library: Library, processes: Library, factor: float = 1.0
    ) -> Array:
        """Columns (N, k) of its forms at their sizes, times a factor."""
        forms = self.forms(library, processes)
        parts = [of.scaled_columns(atom, factor * size) for of, atom, size in forms]
        return np.hstack([np.zeros((len(library.columns), 0)), *parts])


def log_prior(count: int, unknown: bool, effects: int) -> float:
    """Log prior of one set of `count` effects out of `effects`."""
    kinds = _WITH_UNKNOWN if unknown else _WITHOUT_UNKNOWN
    sets = special.comb(max(effects, 1), count)
    probability = sum(PRIOR[kind] for kind in kinds[count])
    return float(np.log(probability) - np.log(sets))
