"""Long traces: memory and answers of whole diagnoses, in processes of their own."""

import pytest

from benchmarks.harness.processes import alone
from benchmarks.long_traces import diagnose_once

MOST = 2048.0  #: most memory of a process, MiB, with Python and all libraries


@pytest.mark.slow
@pytest.mark.parametrize("readings", [5000, 20000])
@pytest.mark.parametrize(("gap", "answer"), [(True, "backlash"), (False, "no gap")])
def test_a_diagnosis_of_long_traces_fits_into_memory(readings, gap, answer):
    diagnosed = alone(diagnose_once, readings, gap)
    assert diagnosed.memory < MOST
    assert diagnosed.answer.startswith(answer)
