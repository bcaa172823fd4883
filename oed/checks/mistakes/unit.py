"""Readings in another unit than their column states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed import units
from oed.checks.mistakes.variant import Alternatives, Variant
from oed.checks.session import SessionReadings

#: units that a file's readings may be in, beside those of a column
OTHERS = {"m": {"inch": units.INCH}, "rad": {}, "1": {}}


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """The readings of a kind, all and by set-up, in each other unit of that kind."""
    channels = session.values["channel"].to_numpy()
    kind = np.array([session.unit(c) for c in channels])
    setups = session.values["setup"].to_numpy()
    names = list(dict.fromkeys(setups))
    for si in dict.fromkeys(kind):
        of_kind = kind == si
        stated = session.column(channels[of_kind][0])
        word = stated.name.rpartition("_")[2]
        for name, factor in _factors(str(si)).items():
            if factor == stated.factor:
                continue
            groups = [("", of_kind)]
            if len(names) > 1:
                groups += [(f" of {n}", of_kind & (setups == n)) for n in names]
            for whose, members in groups:
                scale = np.where(members, factor / stated.factor, 1.0)
                what = f"the readings{whose} are in {name}, not in {word}"
                changed = session.with_y(session.y * scale)
                yield Variant("unit", what, changed, float(np.log(scale).sum()))


def _factors(si: str) -> dict[str, float]:
    """Factors to SI of the units of a kind, by name."""
    known = {name: factor for name, (unit, factor) in units.UNITS.items() if unit == si}
    return {**known, **OTHERS.get(si, {})}
