"""`oed next` against the fixed plan, over virtual machines.

    python -m benchmarks.next_reading [STUDY] [MACHINES] [--page PAGE]

Each machine is drawn from the tolerances and read with noise, one reading after another,
always the one that is advised, until the advice is to stop: once every component is as
accurate as the study's plan would be on this machine, as far as it is known
(`--wanted plan`). Printed, or written into a page: how many readings that takes, and the
accuracy of both at the machine's true parameters, which the advice never knows.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.coverage import table
from oed import simulation
from oed.arrays import Array
from oed.design import candidates
from oed.measurement import Series
from pkm_studies import shipped
from pkm_studies.next_reading import AS_PLANNED, Advice, Adviser
from pkm_studies.study import load

#: readings at which a machine counts as not reached
MOST = 60
#: quantiles that are printed, and those of their bootstrap intervals of means
LOW, HIGH = 0.05, 0.95
#: ratios of accuracy that are counted
NEAR = (1.0, 1.02, 1.05)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A session on one machine.

    readings  until the advice was to stop
    ratios    (K,) rms of each component over that of the fixed plan, at the machine's
              true parameters
    seconds   processor time of each advice
    """

    readings: int
    ratios: Array
    seconds: Sequence[float]


@dataclasses.dataclass
class Session:
    """Readings of one machine (theta), in the order in which they are advised."""

    adviser: Adviser
    theta: Array
    rng: np.random.Generator
    taken: list[int] = dataclasses.field(default_factory=list)
    pools: dict[str, Series] = dataclasses.field(default_factory=dict)
    rows: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    values: dict[str, list[Array]] = dataclasses.field(default_factory=dict)
    seconds: list[float] = dataclasses.field(default_factory=list)

    def run(self) -> None:
        """Read what is advised until the advice is to stop."""
        while len(self.taken) < MOST:
            begin = time.process_time()
            advice = self._advice()
            self.seconds.append(time.process_time() - begin)
            if advice.is_reached:
                return
            self._read(advice)

    def _advice(self) -> Advice:
        measurement = self.adviser.base.resolved.measurement
        series = []
        for setup, rows in self.rows.items():
            one = self.pools[setup].take(np.array(rows))
            labels = np.array([str(k + 1) for k in range(len(rows))])
            series.append(dataclasses.replace(one, run=labels))
        readings = [value for values in self.values.values() for value in values]
        y = np.concatenate(readings) if readings else np.zeros(0)
        return self.adviser.advise_after(measurement, series, y)

    def _read(self, advice: Advice) -> None:
        setup = advice.series.setup
        one = advice.series.take(np.array([advice.row]))
        measurement = self.adviser.base.resolved.measurement
        reading = simulation.draw_readings(measurement, [one], self.theta, self.rng)
        self.pools.setdefault(setup, advice.series)
        self.rows.setdefault(setup, []).append(advice.row)
        self.values.setdefault(setup, []).append(reading)
        self.taken.append(advice.candidate)


def one_machine(adviser: Adviser, number: int) -> Outcome:
    """The session on a machine of this number."""
    measurement = adviser.base.resolved.measurement
    rng = np.random.default_rng([adviser.base.study.seed, number])
    draw = rng.standard_normal(len(measurement.nominal))
    session = Session(adviser, measurement.nominal + measurement.tolerance * draw, rng)
    session.run()
    chosen = adviser.base.resolved.candidates
    pool = candidates.build(measurement, chosen, session.theta, "tolerance")
    fixed, advised = (
        adviser.accuracy(measurement, pool, indices)
        for indices in (adviser.plan, session.taken)
    )
    return Outcome(len(session.taken), advised / fixed, session.seconds)


def markdown(study: str, adviser: Adviser, outcomes: Sequence[Outcome]) -> str:
    """The table: readings, and the accuracy of each component."""
    fixed = len(adviser.plan)
    needed = np.array([o.readings for o in outcomes])
    mean, half = needed.mean(), _half(needed)
    few, middle, many = np.quantile(needed, [LOW, 0.5, HIGH])
    lines = [
        f"`{study}`, {len(outcomes)} machines; the fixed plan has {fixed} readings.",
        f"`oed next` stops after {mean:.1f} ± {half:.1f} on average:"
        f" {100 * mean / fixed:.1f} ± {100 * half / fixed:.1f} % of the plan's"
        f" (median {middle:.0f}, 5 % to 95 %: {few:.0f} to {many:.0f}).",
        "",
        "| rms over that of the fixed plan | mean | 5 % | median | 95 % | "
        + " | ".join(f"at most {limit}" for limit in NEAR)
        + " |",
        f"| --- |{' --: |' * (4 + len(NEAR))}",
    ]
    ratios = np.array([o.ratios for o in outcomes])
    for name, values in zip(adviser.maps.names, ratios.T, strict=True):
        lines.append(_row(name, values))
    lines.append(_row("worst component", ratios.max(axis=1)))
    lines.append(_row("geometric mean", np.exp(np.log(ratios).mean(axis=1))))
    slowest = max(max(o.seconds) for o in outcomes)
    typical = np.median([s for o in outcomes for s in o.seconds])
    lines += [
        "",
        f"Processor time of an advice: {typical:.2f} s (median), {slowest:.2f} s at most.",
    ]
    return "\n".join(lines)


def _row(name: str, values: Array) -> str:
    low, middle, high = np.quantile(values, [LOW, 0.5, HIGH])
    shares = " | ".join(f"{100 * np.mean(values <= limit):.0f} %" for limit in NEAR)
    spread = f"{low:.3f} | {middle:.3f} | {high:.3f}"
    return (
        f"| {name} | {values.mean():.3f} ± {_half(values):.3f} | {spread} | {shares} |"
    )


def _half(values: Array) -> float:
    """Half the 95 % interval of a mean."""
    if len(values) < 2:
        return float("inf")
    return float(1.96 * values.std(ddof=1) / np.sqrt(len(values)))


def main() -> None:
    """Read the machines, and print or write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.next_reading")
    parser.add_argument("study", nargs="?", default="a3_ball_bar")
    parser.add_argument("machines", nargs="?", type=int, default=200)
    parser.add_argument("--page", type=Path, help="page to write the table into")
    options = parser.parse_args()
    study = load(shipped.study_path(Path(options.study)))
    adviser = Adviser(study, AS_PLANNED)
    outcomes = []
    for number in range(options.machines):
        outcomes.append(one_machine(adviser, number))
        last = outcomes[-1]
        print(
            f"{number + 1}: {last.readings} readings, worst {last.ratios.max():.3f}",
            flush=True,
        )
    text = markdown(options.study, adviser, outcomes)
    if options.page is None:
        print(text)
    else:
        table.write_block(options.page, "next table", text)


if __name__ == "__main__":
    main()
