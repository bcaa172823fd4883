"""What belongs to an instrument: where it was used, and the zeros of what it reads inside."""

import blunder_machines as machines
import numpy as np
import pytest
from blunder_spatial import prs_poses

from oed.checks.mistakes import Suspect, amounts
from oed.checks.mistakes.suspect import shared_instruments


@pytest.mark.parametrize(
    ("machine", "names"),
    [
        ("a3", []),
        ("hexapod", []),
        ("planar", ["one instrument (dz_mm of ruler; dy_mm of square)"]),
        (
            "a3 in three set-ups",
            [
                "one instrument (length_mm of cup; length_mm of long_tool)",
                "one instrument (length_mm of cup; length_mm of mid_tool)",
                "one instrument (length_mm of long_tool; length_mm of mid_tool)",
            ],
        ),
    ],
)
def test_where_one_instrument_may_have_been_used(
    machine: str, names: list[str]
) -> None:
    """Not in all channels or set-ups of the file: that is a mistake of the file."""
    session = machines.session(machine, machines.readings(machine, 0))
    scopes = shared_instruments(session)
    assert [scope.name for scope, _ in scopes] == names
    for scope, values in scopes:
        assert np.array_equal(
            np.unique(session.reading_of_value[values]), scope.readings
        )


@pytest.mark.parametrize(("name", "axis"), [("range", 0), ("elevation", 1)])
def test_slopes_over_an_inner_zero_are_those_of_another_code(
    name: str, axis: int
) -> None:
    rows = machines.readings("prs", 0)
    given = Suspect(machines.session("prs", rows))
    trial = next(t for t in amounts.trials(given) if f"zero {name} " in t.family)
    q, p, shift, turn, error = rows.attrs["machine"]
    nominal = (q, 0.0 * p, 0.0 * shift, 0.0 * turn)
    step = np.zeros_like(error)
    step[:, :, axis] = 1e-5
    by_steps = prs_poses(*nominal, step) - prs_poses(*nominal, -step)
    assert trial.columns[:, 0] == pytest.approx(by_steps.ravel() / 2e-5, abs=1e-5)


def test_an_instrument_without_inner_readings_has_no_such_zero() -> None:
    given = Suspect(machines.session("planar", machines.readings("planar", 0)))
    families = [trial.family for trial in amounts.trials(given)]
    assert not [name for name in families if name.startswith("zero ")]
