"""How many readings a machine needs that is one of a fleet: each left out in turn.

    python -m benchmarks.fleet --data ../shared/data/klipper_delta > fleet.md

Simulated: fleets of linear deltas with a common offset and a spread of their own, read by a
height probe, which does not see the arms. Of each fleet some machines are left out.
Real, with `--data FOLDER`: printers of one model, of two owners each; one gives the prior
of the other, which is fitted after four heights.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness.tables import head, row
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
MACHINES, LEFT_OUT = 50, 2  #: machines of each fleet, and those that are left out
KNOWN = (1, 3, 10, None)  #: machines that give the prior; None: all others
WANTED = 150e-6  #: rms error of the tool point that is wanted, m
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
FEW = 4  #: first heights after which a printer is fitted with the prior
PLAIN = "\n[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=25)
    parser.add_argument("--data", type=Path, help="folder klipper_delta")
    given = parser.parse_args()
    print("\n".join(simulated(given.fleets)))
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
        is_free = self.measurement.tolerance > 0.0
        frame = self.machine.frame
        names = enumerate(self.names)
        self.free = np.array([k for k, n in names if is_free[k] and n not in frame])
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
        spread[self.free] = [SPREAD[self.names[k].rstrip("123")] for k in self.free]
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


def simulated(fleets: int) -> Iterator[str]:
    """The table of simulated machines, in Markdown."""
    rng = np.random.default_rng(1)
    bench = Bench(rng)
    theta, y = [], []
    priors: dict[str, list[FleetPrior | None]] = {}
    for _ in range(fleets):
        fleet, readings, machines = _fleet(bench, MACHINES, rng)
        for k in range(LEFT_OUT):
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
    columns = ("rms predicted, 9 readings", "reached", "inside 95 %")
    yield head("prior", "readings for 0.15 mm, median", *columns)
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
    return theta, y, [_information(bench, full, values) for values in y]


def _information(bench: Bench, full: Any, y: Array) -> MachineInformation:
    m, free = bench.measurement, bench.free
    fit = identify(m, [full], y)
    block = fit.covariance[np.ix_(free, free)]
    return MachineInformation.from_posterior(
        fit.theta[free], block, m.nominal[free], m.tolerance[free]
    )


def _line(
    name: str, bench: Bench, theta: Array, y: Array, priors: Sequence[FleetPrior | None]
) -> str:
    """A row: readings needed, errors predicted and reached, coverage of the tool's errors."""
    needed, at_nine, inside = [], [], []
    size = len(bench.names)
    for truth, readings, prior in zip(theta, y, priors, strict=True):
        measurement = bench.known_by(prior)
        reached = np.inf
        for n in FIRST:
            series = measurement.series(
                "probe", bench.command[:n], controller=bench.machine.nominal
            )
            fit = identify(measurement, [series], readings[:n])
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
    median = np.median(needed)
    predicted, error = np.sqrt(np.mean(np.square(at_nine), axis=0))
    return row(
        name,
        f"{median:.0f}" if np.isfinite(median) else "more than 60",
        f"{1e3 * predicted:.2f} mm",
        f"{1e3 * error:.2f} mm",
        f"{np.mean(inside):.3f}",
    )


# -- printers --------------------------------------------------------------------------
def printers(data: Path) -> Iterator[str]:
    """The table of real printers, in Markdown."""
    yield head("printer", "prior from", "parameters inside 95 % of the prior")
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


def _run(study: Path, out: Path) -> dict[str, Any]:
    """The result of a study."""
    code = commands.main(["run", str(study), "--out", str(out), "--quiet"])
    if code != 0:
        raise SystemExit(f"{study}: exit code {code}")
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    return result


def _printer(folder: Path, file: str, other: str) -> str:
    """A row: the fit of all readings against the other's prior."""
    own = folder / file
    full = json.loads((own / "all/result.json").read_text())
    text = (own / f"{file}.study.toml").read_text()
    prior = f'\n[prior]\nfrom = ["../{other}/all"]\n\n[[prior.tolerance]]'
    text = text.replace("[[prior.tolerance]]", prior, 1)
    study = own / "fleet.study.toml"
    study.write_text(text.replace(f'"{file}.readings.csv"', '"few.readings.csv"'))
    rows = (own / f"{file}.readings.csv").read_text().splitlines()
    last = sum(line.startswith("#") for line in rows) + 1 + FEW
    held_out = [line for line in rows[last:] if line.startswith("mesh")]
    (own / "few.readings.csv").write_text("\n".join([*rows[:last], *held_out]))
    few = _run(study, own / "fleet")
    priors = {r["name"]: r for r in few["machine"]["parameters"]}
    inside = []
    for name, estimate in full["estimate"]["parameters"].items():
        expected = priors.get(name, {}).get("expected")
        if expected is not None:
            sd = np.hypot(priors[name]["tolerance"], estimate["sd"])
            inside.append(abs(estimate["value"] - expected) < 1.96 * sd)
    return row(file, other, f"{sum(inside)} of {len(inside)}")


if __name__ == "__main__":
    main()
