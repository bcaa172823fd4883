"""Cases of the third world, in files as the second generator has them, and labels.

The size of a fault is sqrt(lambda): the norm of the change of the readings in units of
the noise, free of what geometry and cups within their tolerances take up.
"""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness.worlds import Case
from benchmarks.second.world import case_of
from benchmarks.third import faults
from benchmarks.third import machines as world_machines
from benchmarks.third.faults import World
from benchmarks.third.machines import RUNS, Array, Session, change

#: kinds of a case in turn, one for each machine; an unknown is never listed
KINDS = ("null", "single", "unknown", "single", "pair",
         "single", "null", "unknown", "single", "pair")  # fmt: skip
SIZES, HEALTHY = (4.0, 6.0, 10.0, 20.0), (0.6, 1.4)
CUP, LEVEL = 0.1e-3, 1.0  # m, tolerances of a cup, and of a line's level: it is free
#: a rival that leaves less of sqrt(lambda) explains a fault as well as its own form
EXPLAINED = 5.0
NOISES = ("white", "correlated", "outliers")
RHO, SHARE = 0.8, 0.5  # correlation of neighbours, share of variance that has it


class Sight:
    """What the readings of a session, of a true machine and a noise, show of a fault."""

    def __init__(self, w: World, noise: str, rng: np.random.Generator) -> None:
        self.s, self.world, self.noise = w.s, w, noise
        self.theta = rng.normal(size=len(w.s.machine.sd)) * w.s.machine.sd
        self.cups = rng.normal(size=(2, 3)) * CUP
        self._clean = self.read(change(w.s))
        self._root = np.linalg.cholesky(_covariance(w.s, noise))
        slopes = self._whiten(self._slopes())
        self._count = slopes.shape[1]
        self._basis = np.linalg.qr(np.vstack([slopes, np.eye(self._count)]))[0]

    def read(self, c: Array) -> Array:
        """Noise-free readings of the true machine with a change."""
        return world_machines.readings(self.s, self.theta, self.cups, c)

    def differences(self, c: Array) -> Array:
        """How a change shows once geometry has taken what it can, in noise units."""
        change_of = self._whiten((self.read(c) - self._clean).T.ravel()[:, None])[:, 0]
        padded = np.concatenate([change_of, np.zeros(self._count)])
        return np.asarray(padded - self._basis @ (self._basis.T @ padded))

    def size(self, c: Array) -> float:
        """sqrt(lambda) of a change."""
        return float(np.linalg.norm(self.differences(c)))

    def noise_of_readings(self, rng: np.random.Generator) -> Array:
        """Noise (n, channels), m."""
        values = self._root @ rng.normal(size=self._clean.size)
        if self.noise == "outliers":
            values *= np.where(rng.random(len(values)) < 0.02, 8.0, 1.0)
        return np.asarray(values.reshape(self._clean.T.shape).T)

    def _whiten(self, columns: Array) -> Array:
        """Columns in units of the noise; RM 4 has no dz, which then counts nothing."""
        taken = np.ones(self._clean.size)
        if self.s.machine.name == "planar":
            taken[len(self.s.time) :] = self.s.setup == 0
        return np.linalg.solve(self._root, columns * taken[:, None])

    def _slopes(self) -> Array:
        """Own Jacobian by central differences, one tolerance a column."""
        s, split = self.s, len(self.s.machine.sd)
        values = np.concatenate([self.theta, self.cups.ravel()])
        scales = np.concatenate([s.machine.sd, np.full(6, CUP)])
        columns = []
        for step in np.diag(1e-3 * scales):
            above, below = (
                world_machines.readings(
                    s, p[:split], p[split:].reshape(2, 3), change(s)
                )
                for p in (values + step, values - step)
            )
            columns.append((above - below).T.ravel() / 2e-3)
        if s.machine.name == "planar":
            lines = (s.run[:, None] == np.arange(RUNS)) * LEVEL
            columns += [np.kron(c, line) for c in np.eye(2) for line in lines.T]
        return np.stack(columns, -1)


def _covariance(s: Session, noise: str) -> Array:
    """Of the readings (channels n, channels n), m^2."""
    share = SHARE if noise == "correlated" else 0.0
    n, order = len(s.time), np.arange(len(s.time))
    carried = (s.run[:, None] == s.run) * RHO ** np.abs(order[:, None] - order)
    one = s.machine.sigma**2 * ((1.0 - share) * np.eye(n) + share * carried)
    return np.kron(np.eye(2 if s.machine.name == "planar" else 1), one)


def drawn(seed: int) -> tuple[Sight, dict[str, Any], Array]:
    """The case of a seed: its machine, label and readings (n, channels)."""
    rng = np.random.default_rng([seed, 3])
    count = len(world_machines.MACHINES)
    session = world_machines.session(world_machines.MACHINES[seed % count](), rng)
    kind = KINDS[seed // count % len(KINDS)]
    sight = Sight(faults.world(session, rng), rng.choice(NOISES), rng)
    rivals = _columns(sight, rng)
    names = _names(kind, sorted(rivals), rng)
    acting = []
    for name in names:
        size = rng.choice(SIZES)
        acting.append(_fault(sight, name, size, rng))
    whole = _background(sight, sorted(rivals), rng)
    for fault in acting:
        whole = whole + fault
    label = _label(sight, names, acting, rivals) | {"kind": kind, "seed": seed}
    return sight, label, sight.read(whole) + sight.noise_of_readings(rng)


def _names(kind: str, known: Sequence[str], rng: np.random.Generator) -> list[str]:
    if kind == "unknown":
        return [str(rng.choice(sorted(faults.NEVER_LISTED)))]
    count = {"null": 0, "single": 1, "pair": 2}[kind]
    return [str(name) for name in rng.choice(known, count, replace=False)]


def _fault(sight: Sight, name: str, size: float, rng: np.random.Generator) -> Array:
    """A fault of a size, with a part of it in each drive, cup or axis."""
    makers = faults.listed(sight.s.machine.name) | faults.NEVER_LISTED
    parts = makers[name](sight.world, rng)
    factors = faults.sizes(name, len(parts), rng)
    shape = sum((p * f for p, f in zip(parts, factors, strict=True)), change(sight.s))
    return _sized(sight, shape, size)


def _sized(sight: Sight, c: Array, size: float) -> Array:
    """A change times what makes it as large as wanted, in two steps."""
    for _ in range(2):
        c = c * (size / max(sight.size(c), 1e-9))
    return c


def _background(sight: Sight, known: Sequence[str], rng: Any) -> Array:
    """Small faults of a healthy machine: three of the list, within HEALTHY together."""
    names = rng.choice(known, 3, replace=False)
    parts = [_fault(sight, str(name), 1.0, rng) for name in names]
    return _sized(sight, sum(parts, change(sight.s)), rng.uniform(*HEALTHY))


def _columns(sight: Sight, rng: np.random.Generator) -> dict[str, Array]:
    """For each listed fault what its parts can change in the readings."""
    return {
        name: np.stack([sight.differences(p) for p in make(sight.world, rng)], -1)
        for name, make in faults.listed(sight.s.machine.name).items()
    }


def _remainder(shown: Array, columns: Array) -> float:
    """Norm of what columns do not explain."""
    scale = np.linalg.norm(columns, axis=0).max(initial=0.0) or 1.0
    fit = np.linalg.lstsq(columns / scale, shown, rcond=1e-6)[0]
    return float(np.linalg.norm(shown - columns / scale @ fit))


def _label(
    sight: Sight,
    names: Sequence[str],
    acting: Sequence[Array],
    rivals: Mapping[str, Array],
) -> dict[str, Any]:
    """The label that the judge reads; closures do not count."""
    shown = [sight.differences(fault) for fault in acting]
    effects = []
    for k, name in enumerate(names):
        others = np.array([v for j, v in enumerate(shown) if j != k])
        others = others.reshape(-1, len(shown[k])).T
        effect = _effect(name, shown[k], rivals)
        effect["where"] = _where(sight, acting[k], shown[k])
        effects.append(effect | {"given_other": _remainder(shown[k], others)})
    return {
        "machine": sight.s.machine.name,
        "law": {"law": sight.noise},
        "effects": effects,
        "sqrt_lambda_total": float(np.linalg.norm(sum(shown))),
        "closure": {},
    }


def _effect(name: str, shown: Array, rivals: Mapping[str, Array]) -> dict[str, Any]:
    """Size of a fault, and which of its rivals explain it as well."""
    rest = {n: _remainder(shown, v) for n, v in rivals.items() if n != name}
    equal = {n for n, value in rest.items() if value < EXPLAINED}
    outside = min((v for n, v in rest.items() if n not in equal), default=0.0)
    return {
        "effect": name,
        "sqrt_lambda": float(np.linalg.norm(shown)),
        "classes": sorted({name} | equal) if name in rivals else None,
        "outside": outside if name in rivals else None,
        "out_of_span": min(rest.values()),
    }


def _where(sight: Sight, c: Array, shown: Array) -> dict[str, Any]:
    """Legs and runs that hold an even share and more of what shows."""
    s = sight.s
    of_run = np.tile(s.run, len(sight.read(c).T))
    square = shown[: len(of_run)] ** 2
    energy = np.array([square[of_run == r].sum() for r in range(RUNS)])
    place = {"runs": [int(r) + 1 for r in np.flatnonzero(energy >= energy.mean())]}
    one = np.eye(s.machine.legs)
    each = np.array([sight.size(change(s, legs=c[:, 8:] * leg)) for leg in one])
    if each.max() > 2.0 * np.median(each):
        legs = np.flatnonzero(each**2 >= (each**2).mean())
        place["legs"] = [int(leg) + 1 for leg in legs]
    return place


# -- files -----------------------------------------------------------------------------
def draw(setting: Mapping[str, Any], number: int, folder: Path) -> Case:
    """The case of a seed, in the second generator's files."""
    sight, label, values = drawn(number)
    stem = folder / "case_000"
    case = {
        "machine": label["machine"], "setups": sight.s.setups, "down": [0.0, 0.0, -1.0],
        "screw_lead_mm": 1e3 * faults.LEAD, "scale_period_mm": 0.02, "tolerances": [],
    }  # fmt: skip
    stem.with_suffix(".json").write_text(json.dumps(case), encoding="utf-8")
    with stem.with_suffix(".readings.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows(sight.s, values))
    case_files = case_of(stem, label, folder / "study")
    return dataclasses.replace(case_files, name=f"seed {number}", true_law=None)


def rows(s: Session, values: Array) -> list[list[Any]]:
    """Header and rows of a readings file."""
    planar, first = s.machine.name == "planar", np.searchsorted(s.run, s.run)
    poses = np.hstack([1e3 * s.points[:, planar:], np.degrees(s.tilts)])
    names = ["x_mm", "y_mm", "z_mm"][planar:]
    if s.machine.name == "hexapod":
        names += ["alpha_deg", "beta_deg"]
    shown = 1e3 * (values - values[first] if planar else values)
    channels = ("dy_mm", "dz_mm") if planar else ("length_mm",)
    tail = ("time_s", "direction", "feed_mm_min", "payload_N")
    table: list[list[Any]] = [["setup", "run", "order", *names, *channels, *tail]]
    for n in range(len(s.time)):
        setup = s.setups[s.setup[n]]
        cells = [f"{v:.7f}" for v in shown[n]]
        if setup.get("measurement") == "RM4":
            cells[1] = ""
        table.append([
            setup["name"], int(s.run[n]) + 1, n - int(first[n]) + 1,
            *[f"{v:.9f}" for v in poses[n, : len(names)]], *cells,
            f"{s.time[n]:.3f}", int(s.direction[n]), s.feed[n], s.payload[n],
        ])  # fmt: skip
    return table
