"""Readings, or their deviations from what is nominal, with the sign reversed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.checks.mistakes.deviation import lengths
from oed.checks.mistakes.variant import Alternatives, Variant, channel_sets
from oed.checks.session import SessionReadings


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """Each channel with the other sign, and with deviations of the other sign."""
    measurement = session.measurement
    predicted = measurement.readings(session.series, measurement.nominal)
    length = lengths(session)
    for channel, setups in channel_sets(session):
        groups = [setups] if len(setups) == 1 else [setups, *([s] for s in setups)]
        column = session.column(channel).name
        for names in groups:
            members = np.any([session.mask(n, channel) for n in names], axis=0)
            of = f"{column}" if len(names) == len(setups) else f"{column} in {names[0]}"
            y = np.where(members, -session.y, session.y)
            yield Variant("sign", f"the sign of {of} is reversed", session.with_y(y))
            about = members & np.isfinite(length)
            if about.any():
                y = np.where(about, 2.0 * length - session.y, session.y)
                what = (
                    f"the sign of the deviations of {of} from the nominal length is"
                    " reversed"
                )
                yield Variant("sign", what, session.with_y(y))
            y = np.where(members, 2.0 * predicted - session.y, session.y)
            what = (
                f"the sign of the deviations of {of} from the nominal machine is"
                " reversed"
            )
            yield Variant("sign", what, session.with_y(y))
