"""A small planning study: lines of the planar machine in two measurements."""

from __future__ import annotations

from pathlib import Path

from oed.result import PlanSection, StudyResult
from pkm_studies import pipeline, study

LINES = """\
[[plan.measurement]]
name = "RM {n}"
setup = "rm{n}"
counts = [1, 2, 3]
whole_runs = true
operator = "workshop"
price = 10.0
y_mm = {y}
z_mm = {z}
runs_by = "{by}"
"""
STUDY = """\
schema = 1
name = "lines"

[machine]
model = "planar_2dof"

[[setup]]
name = "rm4"
instrument = "rm4"

[[setup]]
name = "rm5"
instrument = "rm5"

[plan]
budget_min = 110.0
stages = 2
compare = [["RM 4", "RM 5"], ["RM 5"]]

"""
STUDY += LINES.format(
    n=4, y="[-1500.0, 0.0, 1500.0]", z="[0.0, 500.0, 1000.0, 1500.0]", by="y"
)
STUDY += LINES.format(
    n=5, y="[0.0, -1500.0, -750.0, 750.0, 1500.0]", z="[0.0, 750.0, 1500.0]", by="z"
)
STUDY += """
[prediction]
reference = "home"
y_mm = [-1500.0, -500.0, 500.0, 1500.0]
z_mm = [0.0, 750.0, 1500.0]

[report]
html = false
pdf = false
"""
HERE = Path("lines.study.toml")


def planned(text: str, out: Path, after: Path | None = None) -> StudyResult:
    return pipeline.plan(study.parse(text, HERE), out, after=after)


def plan_of(result: StudyResult) -> PlanSection:
    assert result.plan is not None
    return result.plan
