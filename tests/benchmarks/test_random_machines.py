"""The benchmark of random machines: its readings, its units, and a handful of them."""

import numpy as np
import pytest

from benchmarks.random_machines import cases, scaling, sessions
from oed.gap.forms import library

#: the nightly run has one family of each kind
FAMILIES = [
    "delta",
    *(
        pytest.param(name, marks=pytest.mark.slow)
        for name in ("hexapod_ups", "cables_planar", "tripod_rps")
    ),
]


@pytest.mark.parametrize("name", sessions.LAWS)
def test_noise_has_the_stated_spread(name: str) -> None:
    law = sessions.Law(name, share=0.8, reach=5.0, offset=2.0)
    rng = np.random.default_rng(4)
    chains = np.array([law.chain(40, rng) for _ in range(1500)])
    variance = 1.0 + law.offset**2 if name == "offsets" else 1.0
    assert np.mean(chains**2) == pytest.approx(variance, rel=0.1)
    beside = np.mean(chains[:, 1:] * chains[:, :-1])
    wanted = {"along": 0.8 * np.exp(-0.2), "offsets": 4.0}.get(name, 0.0)
    assert beside == pytest.approx(wanted, abs=0.1 * variance)


@pytest.mark.parametrize("model", FAMILIES)
def test_columns_of_effects_have_no_unit_of_length(model: str) -> None:
    """In units of the noise they are the same a thousand times as large.

    They are those at the fitted parameters, which are a little apart: a fit ends where
    it hardly improves.
    """
    kind = "planar_position" if model == "cables_planar" else "ball_bar"
    drawn = cases.draw_fully_read(model, kind, 6)
    larger = scaling.scaled(drawn)
    usual, effects = scaling.prepared(drawn, 1.0)
    other, scaled = scaling.prepared(larger, scaling.FACTOR)
    apart = np.abs(other.slopes - usual.slopes).max()
    assert apart < 1e-4 * np.abs(usual.slopes).max()
    for effect, effect_there in zip(effects, scaled, strict=True):
        here = library.build(usual, [effect])
        there = library.build(other, [effect_there])
        assert there.columns.shape == here.columns.shape, effect.name
        columns = here.columns.all()
        size = np.abs(columns).max(axis=0, initial=1e-6)
        change = np.abs(there.columns.all() - columns) / size
        assert change.max(initial=0.0) < 1e-2, effect.name


def test_the_table_counts_alarms() -> None:
    made = {
        "model": "delta",
        "law": "white",
        "plan": "one way, no time",
        "instruments": ["camera"],
        "size_m": 0.4,
        "runs": 4,
        "readings": 20,
    }
    records = [{**made, "verdict": v} for v in ("none", "none", "unknown", "failed")]
    rows = cases.table(records).splitlines()
    assert rows[2] == "| all | 4 | 2 (50.0 %) | 15.0..85.0 % |"
    assert rows[3].startswith("| `delta` | 4 | 2 ")


@pytest.mark.slow
def test_few_random_machines_are_said_to_have_a_gap() -> None:
    """Nothing fails, and of five machines at most two alarm."""
    records = [cases.alarm({"stream": 7}, number) for number in range(4, 9)]
    assert not [r["traceback"] for r in records if r["verdict"] == cases.FAILED]
    assert sum(map(cases.is_alarm, records)) <= 2
