"""Order of measurements that a plan for a real machine has, beside that for a rigid one.

    python -m benchmarks.real_machines.orders planar_plan prs_plan a3_plan

Each study is planned twice, with effects = "catalogue" and without. The table states the
measurements with their readings, what the rigid plan promises, and what both leave on a
machine with effects.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path

import msgspec

from oed.planning import StagePlan
from pkm_studies import shipped
from pkm_studies.resolve import resolve
from pkm_studies.stages.plan.task import build_task
from pkm_studies.study import Study

HEAD = (
    "| study | plan for a rigid machine | promises | leaves with effects |"
    " plan for a real machine | leaves |\n|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="+")
    print(HEAD, flush=True)
    for name in parser.parse_args().studies:
        print(row(name), flush=True)


def row(name: str) -> str:
    """The line of one shipped study."""
    study = Study.load(shipped.study_path(Path(name)))
    assert study.plan is not None
    table = msgspec.structs.replace(
        study.plan, effects="catalogue", virtual_machines=0, compare=[]
    )
    study = msgspec.structs.replace(study, plan=table)
    resolved = resolve(study, readings=[])
    request = resolved.plan
    assert request is not None
    real = build_task(resolved, request, [study.seed], None)
    options = tuple(option.without_effects() for option in request.options)
    without = dataclasses.replace(request, options=options, effects=None)
    rigid = build_task(resolved, without, [study.seed], None)
    chosen, promised = real.search().best, rigid.search().best
    readings = [(request.option(s.option.name), s.chosen) for s in promised.stages]
    reached = real.predict(readings)
    cells = [
        f"`{name}`",
        _stages(promised),
        _values(rigid.accuracy_after(promised)),
        _values(real.accuracy_after(reached)),
        _stages(chosen),
        _values(real.accuracy_after(chosen)),
    ]
    return f"| {' | '.join(cells)} |"


def _stages(plan: StagePlan) -> str:
    return ", ".join(f"{s.option.name} ({len(s.chosen)})" for s in plan.stages)


def _values(accuracy: Mapping[str, float]) -> str:
    """Lengths alone, um."""
    lengths = {k: v for k, v in accuracy.items() if k.endswith("_um")}
    return ", ".join(f"{k.removesuffix('_um')} {v:.3g}" for k, v in lengths.items())


if __name__ == "__main__":
    main()
