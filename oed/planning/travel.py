"""Which readings can be taken at all: an instrument follows a machine no farther than
its travel.

A reading y_i = h_i d + g_i s + e_i of a machine with error d and a set-up with unknowns
s ~ N(0, 1) is lost where |h_i d + g_i s| is beyond the travel. Readings of one run are
lost together.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from oed.arrays import Array, Index, Mask
from oed.planning.known import Known, known
from oed.planning.option import Option

#: machines drawn to tell how often a whole run can be read
MANY = 1000


def available(option: Option, before: Array | Known) -> Array:
    """Probability (C,) that a machine can be read at each candidate; `before` is known
    of it, or a covariance (n, n).

    Readings of one run are lost together; how often, is told by drawn machines.
    """
    if option.travel is None:
        return np.ones(len(option.candidates))
    first, count = option.candidates.members.T
    machines = known(before)
    if (count == 1).all():
        return np.asarray(_singly(option, machines)[first])
    rng = np.random.default_rng(0)
    _, errors, _ = machines.drawn(max(MANY // len(machines.kinds), 1), rng)
    everyone = np.arange(len(option.candidates))
    own = rng.standard_normal((len(errors), own_columns(option)))
    return np.asarray(within(option, everyone, errors, own).mean(axis=0))


def available_at_most(option: Option, before: Array | Known) -> Array:
    """A bound (C,) of the same from above: a run is no more likely to be read than the
    farthest of its readings.
    """
    if option.travel is None:
        return np.ones(len(option.candidates))
    single = _singly(option, known(before))
    return np.array(
        [
            single[first : first + count].min()
            for first, count in option.candidates.members
        ]
    )


def own_columns(option: Option) -> int:
    """Unknowns of the option's set-ups."""
    return int(option.measurement.free.sum()) - option.machine_columns


def within(option: Option, chosen: Index, errors: Array, own: Array) -> Mask:
    """Which chosen candidates (N,) machines with errors (P, n), and set-ups with
    unknowns `own` (P, s), can give: (P, N), all readings of a candidate being within
    the travel.
    """
    assert option.travel is not None
    off = np.abs(np.hstack([errors, own]) @ option.first_channels.T) <= option.travel
    first, count = option.candidates.members[chosen].T
    # the last column is only an end that `reduceat` may name
    padded = np.hstack([off, np.ones((len(off), 1), dtype=bool)])
    return np.asarray(
        np.logical_and.reduceat(
            padded, np.column_stack([first, first + count]).ravel(), axis=1
        )[:, ::2]
    )


def _singly(option: Option, machines: Known) -> Array:
    """Probability (readings,) that each reading by itself is within the travel, by
    machine and set-up.
    """
    assert option.travel is not None
    rows, n = option.first_channels, option.machine_columns
    own = np.sum(rows[:, n:] ** 2, axis=1)
    if machines.errors is not None:
        by_setup = np.sqrt(np.maximum(2.0 * own, 1e-300))
        off = machines.errors @ rows[:, :n].T
        ends = erf((option.travel - off) / by_setup) + erf(
            (option.travel + off) / by_setup
        )
        return np.asarray(0.5 * ends.mean(axis=0))
    by_machine = np.einsum(
        "in,pnm,im->pi", rows[:, :n], machines.kinds, rows[:, :n], optimize=True
    )
    deviation = np.sqrt(np.maximum(own + by_machine, 1e-300))
    return np.asarray(erf(option.travel / deviation / np.sqrt(2.0)).mean(axis=0))
