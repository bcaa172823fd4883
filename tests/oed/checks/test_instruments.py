"""What belongs to an instrument: where it was used, and the zeros of what it reads inside."""

import itertools

import blunder_machines as machines
import numpy as np
import pytest
from blunder_spatial import prs_poses

from oed.checks.mistakes import Suspect, amounts

PAIRS = [
    f"length_mm of {one}; length_mm of {other}"
    for one, other in itertools.combinations(("cup", "long_tool", "mid_tool"), 2)
]


@pytest.mark.parametrize(("machine", "names"), [
    ("a3", []),
    ("hexapod", []),
    ("planar", ["dz_mm of ruler; dy_mm of square"]),
    ("a3 in three set-ups", PAIRS),
])  # fmt: skip
def test_where_one_instrument_may_have_been_used(machine, names):
    """Not in all channels or set-ups of the file: that is a mistake of the file."""
    session = machines.session(machine, machines.readings(machine, 0))
    scopes = Suspect(session).instruments
    wanted = [f"one instrument ({name})" for name in names]
    assert [scope.name for scope in scopes] == wanted
    for scope in scopes:
        readings = np.unique(session.reading_of_value[scope.values])
        assert np.array_equal(readings, scope.readings)


@pytest.mark.parametrize(("name", "axis"), [("range", 0), ("elevation", 1)])
def test_slopes_over_an_inner_zero_are_those_of_another_code(name, axis):
    rows = machines.readings("prs", 0)
    given = Suspect(machines.session("prs", rows))
    trial = next(t for t in amounts.trials(given) if f"zero {name} " in t.family)
    q, p, shift, turn, error = rows.attrs["machine"]
    nominal = (q, 0.0 * p, 0.0 * shift, 0.0 * turn)
    step = np.zeros_like(error)
    step[:, :, axis] = 1e-5
    by_steps = prs_poses(*nominal, step) - prs_poses(*nominal, -step)
    assert trial.columns[:, 0] == pytest.approx(by_steps.ravel() / 2e-5, abs=1e-5)


def test_an_instrument_without_inner_readings_has_no_such_zero():
    given = Suspect(machines.session("planar", machines.readings("planar", 0)))
    families = [trial.family for trial in amounts.trials(given)]
    assert not [name for name in families if name.startswith("zero ")]
