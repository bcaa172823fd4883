"""Noise of the set-ups, and what else of it is stated, as the study gives them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

from oed.instrument import Setup
from oed.measurement import Measurement
from oed.noise import NoiseStatement
from oed.text import suggest
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.study import Study

#: least and largest noise of an instrument, and largest tolerance, SI: beyond them sums of
#: squares lose all digits
LEAST_SIGMA, LARGEST = 1e-12, 1e3
#: ends of the names of an error that all readings of a run share, and of a display's step
RUN, RESOLUTION = "_run", "_resolution"
#: name of what each run seats anew
SEATING = "seating"
#: degrees of freedom from which on the scale of a noise is known to a third
MIN_FREEDOM_OF_SCALE = 4


def noise_is_a_guess(study: Study, measurement: Measurement, count: int) -> bool:
    """Whether `count` values correct the stated noise, so that larger ones fit as well.

    So it is where the study says so, and where the noise is an assumption, and enough
    values remain beyond the parameters.
    """
    unknowns = int(measurement.free.sum())
    is_tested = count - unknowns >= MIN_FREEDOM_OF_SCALE
    return study.noise.estimate is True or (study.noise.assumed and is_tested)


def with_noise(study: Study, setups: Mapping[str, Setup]) -> dict[str, Setup]:
    """Set-ups with the standard deviation of each channel, and what else is stated.

    A number for one set-up goes before one for all, and that before the instrument's.
    Raises InputError.
    """
    location = study.location.key("noise")
    common, special = quantities.split_tables(study.noise.sigma)
    for name in special:
        if name not in setups:
            raise location.key(name).error("no such set-up", suggest(name, setups))
    law = _law(study, location)
    general = _amounts(common, list(setups.values()), location)
    noisy = {}
    for name, setup in setups.items():
        stated = _amounts(special.get(name, {}), [setup], location.key(name))
        noisy[name] = _add_amounts(setup, general | stated, law)
    return noisy


def _law(study: Study, location: Location) -> NoiseStatement:
    """What is stated of all readings."""
    table = study.noise
    if table.carried == 0.0 and table.reach_readings is not None:
        raise location.key("reach_readings").error(
            "nothing is carried along, as carried = 0",
            "remove one of the two",
            table.reach_readings,
        )
    if table.student_dof is not None and table.outlier_share:
        raise location.key("outlier_share").error(
            "student_dof states the tails already",
            "remove one of the two",
            table.outlier_share,
        )
    # what nobody measured anchors nothing: no part of it is split into further parts
    nothing = 0.0 if table.assumed else None
    return NoiseStatement(
        correlated=nothing if table.carried is None else table.carried,
        reach=table.reach_readings,
        student_dof=table.student_dof,
        outlier_share=table.outlier_share,
        is_assumed=table.assumed,
        has_course=table.course,
    )


def _add_amounts(
    setup: Setup, stated: Mapping[str, float], law: NoiseStatement
) -> Setup:
    """A set-up with stated amounts of noise, SI, by name.

    `channel_run` is a run's error, `channel_resolution` the step of its display, whose
    rounding has a twelfth of its square as variance (Sheppard 1898).
    """
    protocol = setup.protocol
    root = math.sqrt(len(protocol.pass_names)) if protocol.average else 1.0
    channels, sigma = [], []
    for channel in setup.instrument.channels:
        step = stated.get(f"{channel.name}{RESOLUTION}", 0.0)
        single = stated.get(channel.name, channel.sigma)
        single = math.hypot(single, step / math.sqrt(12.0))
        run = stated.get(f"{channel.name}{RUN}", channel.shared * single)
        channels.append(
            dataclasses.replace(channel, shared=run / single, resolution=step)
        )
        sigma.append(single / root)
    levels = [c.name for c in channels if f"{c.name}{RUN}" in stated or law.is_assumed]
    statement = dataclasses.replace(
        law,
        levels=frozenset(levels),
        seating=stated.get(SEATING) if setup.instrument.renewed else None,
    )
    instrument = dataclasses.replace(setup.instrument, channels=tuple(channels))
    return dataclasses.replace(
        setup, instrument=instrument, sigma=tuple(sigma), statement=statement
    )


def _amounts(
    table: Mapping[str, float], setups: Sequence[Setup], location: Location
) -> dict[str, float]:
    """Amounts of noise, SI, by name: what a table states of some set-ups."""
    unit_of = _units(table, setups)
    values = quantities.read_values(table, unit_of, location)
    for key, (name, value) in zip(table, values.items(), strict=True):
        _check_amount(name, value, location.key(key), table[key])
        if value != 0.0 and not LEAST_SIGMA <= value <= LARGEST:
            raise location.key(key).error(
                "no instrument has such a noise",
                f"check its unit; {LEAST_SIGMA:g} to {LARGEST:g} {unit_of[name]} are"
                " possible",
                table[key],
            )
        if name == SEATING and not any(s.instrument.renewed for s in setups):
            names = ", ".join(s.name for s in setups)
            raise location.key(key).error(
                f"no run of {names} seats anything anew",
                "remove it: it is for a ball bar, whose cup each run seats anew",
                table[key],
            )
    return values


def _units(table: Mapping[str, float], setups: Sequence[Setup]) -> dict[str, str]:
    """SI units of the amounts that can be stated of some set-ups, by name."""
    channels = [c for s in setups for c in s.instrument.channels]
    unit_of = {c.name: c.unit for c in channels}
    unit_of |= {f"{c.name}{end}": c.unit for c in channels for end in (RUN, RESOLUTION)}
    renewed = {
        n.unit for s in setups for n in s.nuisances if n.name in s.instrument.renewed
    }
    if renewed or any(key.startswith(SEATING) for key in table):
        unit_of[SEATING] = next(iter(renewed), "m")
    return unit_of


def _check_amount(name: str, value: float, location: Location, amount: float) -> None:
    """Raises InputError for a negative amount, and for single readings without noise."""
    if name.endswith(RUN) or name == SEATING:
        if value < 0.0:
            raise location.error(
                "an amount of noise is a standard deviation",
                "give a number >= 0; 0 says that there is none",
                amount,
            )
    elif value <= 0.0:
        raise location.error(
            "noise must be above 0",
            "give the standard deviation of one reading",
            amount,
        )
