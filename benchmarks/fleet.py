"""How many readings a machine needs that is one of a fleet: each left out in turn.

    python -m benchmarks.fleet --data ../shared/data/klipper_delta > fleet.md

Simulated: fleets of linear deltas with a common offset and a spread of their own, read by a
height probe, which does not see the arms. Of each fleet some machines are left out.
Real, with `--data FOLDER`: printers of one model, of two owners each; one gives the prior
of the other.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oed import build_study
from oed.accuracy import ErrorMaps
from oed.base import Array
from oed.estimation import identify
from oed.history import FleetPrior, MachineInformation, fleet_prior
from oed.measurement import Measurement
from oed.mechanism import Kinematics
from pkm_studies import commands
from pkm_studies.importers import import_files
from pkm_studies.resolve import replace_mean_and_covariance, resolve

#: readings of the members of the fleet, and of the machine that is left out
FULL, FIRST = 60, (3, 6, 9, 12, 18, 24, 36, 60)
#: machines that give the prior; None: all others
KNOWN = (1, 3, 10, None)
#: rms error of the tool point that is wanted, m
WANTED = 150e-6
#: spread between machines over the tolerance, by first letters of a parameter
SPREAD = {"arm": 0.1, "radius": 0.2, "angle": 0.3, "endstop": 0.6}
STUDY: dict[str, Any] = {
    "name": "fleet",
    "machine": {"model": "linear_delta"},
    "setup": [{"name": "probe", "instrument": "height_probe"}],
    "noise": {"height_um": 20.0},
}
#: printers of one model with different owners: the file, and that of the prior
PRINTERS = (
    ("flsun_sr_danorder_mesh", "flsun_sr_cupsster"),
    ("flsun_sr_cupsster", "flsun_sr_danorder_mesh"),
    ("flsun_v400_fzechert", "flsun_v400_phnxdrgn"),
    ("flsun_v400_phnxdrgn", "flsun_v400_fzechert"),
)
PLAIN = "\n[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=25)
    parser.add_argument("--machines", type=int, default=50, help="of each fleet")
    parser.add_argument("--left-out", type=int, default=2, help="of each fleet")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--data", type=Path, help="folder klipper_delta")
    given = parser.parse_args()
    print("\n".join(simulated(given)))
    if given.data is not None:
        print("\n" + "\n".join(printers(given.data)))


# -- simulated machines ----------------------------------------------------------------


class Bench:
    """The measurement of a machine, its readings in working order, and its error maps."""

    def __init__(self, rng: np.random.Generator) -> None:
        study = resolve(build_study(STUDY), readings=[])
        self.measurement: Measurement = study.measurement_with(study.setups)
        angle = rng.uniform(0.0, 2.0 * np.pi, FULL)
        radius = 0.1 * np.sqrt(rng.uniform(0.0, 1.0, FULL))
        flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        self.command = np.column_stack([flat, np.zeros(FULL)])
        self.free = np.flatnonzero(self.measurement.tolerance > 0.0)
        self.free = self.free[self.free < len(self.machine.parameters)]
        self.free = np.array(
            [k for k in self.free if self.names[k] not in self.machine.frame]
        )
        grid = np.linspace(-0.08, 0.08, 5)
        x, y, z = np.meshgrid(grid, grid, [0.02, 0.15])
        self.maps = ErrorMaps.of(
            self.measurement.kinematics,
            np.column_stack([x.ravel(), y.ravel(), z.ravel()]),
        ).raw

    @property
    def machine(self) -> Any:
        return self.measurement.machine

    @property
    def names(self) -> list[str]:
        return [p.name for p in self.machine.parameters]

    def population(self, count: int, rng: np.random.Generator) -> Array:
        """Parameters with the probe's offset (count, n) of a fleet."""
        tolerance = self.measurement.tolerance
        spread = np.ones(len(tolerance))
        for k in self.free:
            stem = self.names[k].rstrip("123")
            spread[k] = SPREAD[stem]
        fixed = np.ones(len(tolerance), dtype=bool)
        fixed[self.free] = False
        fixed &= np.arange(len(tolerance)) < len(self.names)
        common = np.sqrt(1.0 - spread**2) * rng.standard_normal(len(tolerance))
        own = spread * rng.standard_normal((count, len(tolerance)))
        errors = np.where(fixed, 0.0, tolerance * (common + own))
        return self.measurement.nominal + errors

    def known_by(self, prior: FleetPrior | None) -> Measurement:
        """The measurement of a further machine of a fleet."""
        if prior is None:
            return self.measurement
        tolerance = self.measurement.tolerance[self.free]
        machine = replace_mean_and_covariance(
            self.machine,
            [self.names[k] for k in self.free],
            self.measurement.nominal[self.free] + tolerance * prior.mean,
            prior.covariance * np.outer(tolerance, tolerance),
        )
        setups = list(self.measurement.setups.values())
        return Measurement(machine, setups, Kinematics(machine))


def simulated(given: argparse.Namespace) -> Iterator[str]:
    """The table of simulated machines, in Markdown."""
    rng = np.random.default_rng(given.seed)
    bench = Bench(rng)
    theta, y = [], []
    priors: dict[str, list[FleetPrior | None]] = {}
    for _ in range(given.fleets):
        fleet, readings, machines = _fleet(bench, given.machines, rng)
        for k in range(given.left_out):
            theta.append(fleet[k])
            y.append(readings[k])
            others = machines[:k] + machines[k + 1 :]
            priors.setdefault("tolerances", []).append(None)
            for known in KNOWN:
                count = known or len(others)
                name = f"{count} machine{'s' * (count > 1)}"
                chosen = rng.permutation(len(others))[:count]
                prior = fleet_prior([others[j] for j in chosen])
                priors.setdefault(name, []).append(prior)
    yield (
        "| prior | readings for 0.15 mm, median | machines that reach it |"
        " rms predicted, 9 readings | reached | inside 95 % |"
    )
    yield "|---|---|---|---|---|---|"
    for name, of_machines in priors.items():
        yield _line(name, bench, np.array(theta), np.array(y), of_machines)


def _fleet(
    bench: Bench, count: int, rng: np.random.Generator
) -> tuple[Array, Array, list[MachineInformation]]:
    """Parameters of a fleet, its readings, and what they say."""
    theta = bench.population(count, rng)
    full = bench.measurement.series("probe", bench.command)
    exact = bench.measurement.readings([full], theta)
    sigma = bench.measurement.sigma([full])
    y = exact + sigma * rng.standard_normal(exact.shape)
    return theta, y, [_information(bench, full, row) for row in y]


def _information(bench: Bench, full: Any, y: Array) -> MachineInformation:
    m, free = bench.measurement, bench.free
    fit = identify(m, [full], y)
    block = fit.covariance[np.ix_(free, free)]
    return MachineInformation.of_posterior(
        fit.theta[free], block, m.nominal[free], m.tolerance[free]
    )


def _line(
    name: str, bench: Bench, theta: Array, y: Array, priors: Sequence[FleetPrior | None]
) -> str:
    """A row: readings needed, errors predicted and reached, coverage of the tool's errors."""
    needed, at_nine, inside = [], [], []
    size = len(bench.names)
    for truth, row, prior in zip(theta, y, priors, strict=True):
        measurement = bench.known_by(prior)
        reached = np.inf
        for n in FIRST:
            series = measurement.series(
                "probe", bench.command[:n], controller=bench.machine.nominal
            )
            fit = identify(measurement, [series], row[:n])
            covariance = fit.covariance[:size, :size]
            sd = np.sqrt(
                np.einsum("mkp,pq,mkq->mk", bench.maps, covariance, bench.maps)
            )
            error = bench.maps @ (fit.theta - truth)[:size]
            inside.append(np.mean(np.abs(error) < 1.96 * sd))
            predicted = np.sqrt(np.mean(np.sum(sd**2, axis=1)))
            if n == 9:
                at_nine.append([predicted, np.sqrt(np.mean(np.sum(error**2, axis=1)))])
            if predicted <= WANTED and not np.isfinite(reached):
                reached = n
        needed.append(reached)
    reach = np.isfinite(needed)
    median = (
        f"{np.median(needed):.0f}" if np.isfinite(np.median(needed)) else "more than 60"
    )
    predicted, error = np.sqrt(np.mean(np.square(at_nine), axis=0))
    cells = [name, median, f"{reach.sum()} of {len(reach)}"]
    cells += [
        f"{1e3 * predicted:.2f} mm",
        f"{1e3 * error:.2f} mm",
        f"{np.mean(inside):.3f}",
    ]
    return "| " + " | ".join(cells) + " |"


# -- printers --------------------------------------------------------------------------


def printers(data: Path) -> Iterator[str]:
    """The table of real printers, in Markdown."""
    yield (
        "| printer | prior from | parameters inside 95 % | z after all heights,"
        " tolerances | z after 4, tolerances | z after 4, fleet |"
    )
    yield "|---|---|---|---|---|---|"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in sorted({f for pair in PRINTERS for f in pair}):
            _import(data, folder, file)
        for file, other in PRINTERS:
            yield _printer(folder, file, other)


def _import(data: Path, folder: Path, file: str) -> None:
    study, _ = import_files("klipper", [data / f"{file}.cfg"], folder / file, name=file)
    text = study.read_text()
    lines = [line for line in text.splitlines() if not line.startswith("fixed =")]
    study.write_text("\n".join(lines).replace('"]  # as Klipper', "") + PLAIN)
    _run(study, folder / file / "all")


def _run(study: Path, out: Path) -> None:
    code = commands.main(["run", str(study), "--out", str(out), "--quiet"])
    if code != 0:
        raise SystemExit(f"{study}: exit code {code}")


def _stored(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return result


def _z(result: dict[str, Any]) -> str:
    after = result["prediction"]["components"]["z"]["after"]
    return f"{after['rms']:.0f} {after['unit']}"


def _printer(folder: Path, file: str, other: str) -> str:
    """A row: the other's prior against all readings, and after the first four."""
    study = folder / file / f"{file}.study.toml"
    prior = f'\n[prior]\nfrom = ["../{other}/all"]\n'
    full = _stored(folder / file / "all")
    few = {}
    for name, text in (("tolerances", ""), ("fleet", prior)):
        path = folder / file / f"{name}.study.toml"
        table = study.read_text()
        if text:
            table = table.replace(
                "[[prior.tolerance]]", f"{text}\n[[prior.tolerance]]", 1
            )
        table = table.replace(f'["{file}.readings.csv"]', '["few.readings.csv"]')
        path.write_text(table)
        _first_rows(folder / file, f"{file}.readings.csv", 4)
        _run(path, folder / file / name)
        few[name] = _stored(folder / file / name)
    inside = []
    rows = {r["name"]: r for r in few["fleet"]["machine"]["parameters"]}
    for name, p in full["estimate"]["parameters"].items():
        if name in rows and "expected" in rows[name]:
            row = rows[name]
            sd = np.hypot(row["tolerance"], p["sd"])
            inside.append(abs(p["value"] - row["expected"]) < 1.96 * sd)
    share = f"{sum(inside)} of {len(inside)}"
    cells = [file, other, share, _z(full), _z(few["tolerances"]), _z(few["fleet"])]
    return "| " + " | ".join(cells) + " |"


def _first_rows(folder: Path, name: str, count: int) -> None:
    text = (folder / name).read_text().splitlines()
    comments = [line for line in text if line.startswith("#")]
    rows = [line for line in text if not line.startswith("#")]
    header = next(csv.reader(rows[:1]))
    assert "setup" in header
    (folder / "few.readings.csv").write_text("\n".join([*comments, *rows[: count + 1]]))


if __name__ == "__main__":
    main()
