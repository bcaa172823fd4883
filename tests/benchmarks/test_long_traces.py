"""Long traces: memory and answers of whole diagnoses, in processes of their own."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: most memory of a process, MiB, with Python and all libraries
MOST = 2048.0


@pytest.mark.slow
@pytest.mark.parametrize("law", ["estimated", "known"])
@pytest.mark.parametrize("readings", [5000, 20000])
@pytest.mark.parametrize(("case", "answer"), [("gap", "backlash"), ("none", "no gap")])
def test_a_diagnosis_of_long_traces_fits_into_memory(
    readings: int, law: str, case: str, answer: str
) -> None:
    command = [sys.executable, "-m", "benchmarks.long_traces"]
    done = subprocess.run(
        [*command, "--readings", str(readings), "--law", law, "--row", case],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    row = done.stdout.strip().strip("|").split("|")
    memory, said = float(row[3]), row[4].strip()
    assert memory < MOST
    assert said.startswith(answer)
