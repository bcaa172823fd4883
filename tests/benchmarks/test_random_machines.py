"""The benchmark of random machines: its readings, and a handful of them."""

import numpy as np
import pytest

from benchmarks.random_machines import cases, sessions


@pytest.mark.parametrize("name", sessions.LAWS)
def test_noise_has_the_stated_spread(name):
    law = sessions.Law(name, share=0.8, reach=5.0, offset=2.0)
    rng = np.random.default_rng(4)
    chains = np.array([law.chain(40, rng) for _ in range(1500)])
    variance = 1.0 + law.offset**2 if name == "offsets" else 1.0
    assert np.mean(chains**2) == pytest.approx(variance, rel=0.1)
    beside = np.mean(chains[:, 1:] * chains[:, :-1])
    wanted = {"along": 0.8 * np.exp(-0.2), "offsets": 4.0}.get(name, 0.0)
    assert beside == pytest.approx(wanted, abs=0.1 * variance)


def test_the_table_counts_alarms():
    made = {"model": "delta", "law": "white", "setups": 1}
    records = [{**made, "verdict": v} for v in ("none", "none", "unknown", "failed")]
    rows = cases.table(records).splitlines()
    assert rows[2] == "| all | 4 | 2 (50.0 %) | 15.0..85.0 % |"
    assert rows[3].startswith("| law white | 4 | 2 ")
