"""Adjusted machines reach the accuracy that `oed adjust` predicts, by other closures.

Readings, controller and realised errors come from tests/oracles. The fitter works in
steps of 0.02 mm (0.1 mrad) and errs by up to half of one.
"""

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
import prs_sample
from oracles import adjusted_machines as oracle
from oracles import prs_geometry
from scipy.optimize import least_squares
from shipped_models import a3_head, pose_tracker

from oed.adjustment import AdjustableMachine, AdjustmentPlan
from oed.estimation import fit_machines
from oed.identifiability import parameter_covariance
from oed.instrument import mount
from oed.measurement import Measurement
from oed.mechanism import Kinematics
from oed.model import Adjustment, Machine

STEP, TILT_STEP = 0.02e-3, 0.1e-3  # m, rad
SIGMA = np.array([10e-6] * 3 + [np.deg2rad(5.0 / 3600.0)] * 3)


class Case(NamedTuple):
    """A machine that is adjustable, its oracle, and where its accuracy counts."""

    machine: Machine
    head: oracle.Head
    command: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        lever = self.machine.lever
        return np.array([1.0] * 3 + [lever] * 3)


def adjustable(machine: Machine, starts: tuple[str, ...]) -> Machine:
    """The machine with a fitter for the parameters whose names begin so."""
    parameters = [
        dataclasses.replace(
            p,
            adjust=Adjustment("shim", STEP if p.unit == "m" else TILT_STEP)
            if p.name.startswith(starts) and p.name not in machine.frame
            else None,
        )
        for p in machine.parameters
    ]
    return dataclasses.replace(machine, parameters=tuple(parameters))


def grid(*places: object) -> np.ndarray:
    return np.array(list(itertools.product(*places)), dtype=float)  # type: ignore[call-overload]


TURNS, TILTS = np.deg2rad(np.arange(0.0, 360.0, 60.0)), np.deg2rad([5.0, 20.0, 35.0])
PLACES = grid([1.066, 1.166, 1.266], TURNS, TILTS)
A3 = Case(adjustable(a3_head.machine, ("db", "beta")), oracle.A3, PLACES)


def measured(case, truth, rng):
    """Fitted parameters (m, np) and their covariances, from readings of the oracle."""
    poses = case.command[:: 2 if len(case.command) > 60 else 1]
    instrument = mount(pose_tracker.instrument, "read", tolerances=prs_sample.KNOWN)
    measurement = Measurement(case.machine, [instrument])
    series = [measurement.series("read", poses)]
    q = case.head.nominal(poses)[2]
    readings = []
    for p in truth:
        tip, rotation = case.head.forward(q, p)
        exact = np.hstack([tip, prs_geometry.angles(rotation)])
        readings.append((exact + SIGMA * rng.standard_normal(exact.shape)).ravel())
    count = len(case.machine.parameters)
    theta = fit_machines(measurement, series, np.array(readings))
    covariance = [parameter_covariance(measurement, series, t) for t in theta]
    return theta[:, :count], np.array(covariance)[:, :count, :count]


def total(case: Case, controller: np.ndarray, p: np.ndarray) -> float:
    """Realised total error, m."""
    errors = oracle.errors(case.head, case.command, controller, p) * case.weights
    return float(np.sqrt(np.mean((errors**2).sum(axis=1))))


class Realised(NamedTuple):
    """What became of one machine: its plan, and realised over predicted error."""

    known: AdjustableMachine
    plan: AdjustmentPlan
    ratio: float
    before: float


def adjust_machines(case: Case, count: int, seed: int) -> list[Realised]:
    rng = np.random.default_rng(seed)
    machine = case.machine
    free = np.array([p.name not in machine.frame for p in machine.parameters])
    tolerance = np.array([p.tolerance for p in machine.parameters]) * free
    truth = tolerance * rng.standard_normal((count, len(tolerance)))
    kinematics = Kinematics(machine)
    realised = []
    for p, *estimate in zip(truth, *measured(case, truth, rng), strict=True):
        known = AdjustableMachine(
            kinematics, case.command, "home", *estimate, case.weights
        )
        plan = known.plan()
        at, amounts = list(plan.parameters), plan.amounts
        units = [machine.parameters[k].unit for k in at]
        step = np.array([STEP if unit == "m" else TILT_STEP for unit in units])
        adjusted, controller = p.copy(), estimate[0].copy()
        adjusted[at] += amounts + step * rng.uniform(-0.5, 0.5, len(at))
        controller[at] += amounts
        after = total(case, controller, adjusted)
        ratio = after / plan.accuracy[-1].total
        realised.append(Realised(known, plan, ratio, total(case, estimate[0], p)))
    return realised


def assert_worth_its_lines(realised: list[Realised]) -> None:
    for _, plan, _, _ in realised:
        after = plan.accuracy[-1].total
        assert (plan.without > 1.05 * after).all()
        assert after <= plan.accuracy[0].total


def assert_no_line_is_idle(case: Case, one: Realised) -> None:
    """Without any line the others leave more than 5 % more error, by an optimiser."""
    known, plan, _, _ = one
    at = np.array(plan.parameters)
    after = plan.accuracy[-1].total
    moved = known.identified.copy()
    moved[at] += plan.amounts
    unknown = after**2 - total(case, moved, moved) ** 2
    scale = np.sqrt(len(case.command))
    for line in range(len(at)):
        others = np.delete(at, line)

        def misfit(amounts: np.ndarray, others: np.ndarray = others) -> np.ndarray:
            p = known.identified.copy()
            p[others] += 1e-3 * amounts
            errors = oracle.errors(case.head, case.command, p, p)
            return (errors * case.weights).ravel() / scale * 1e6

        start = 1e3 * np.delete(plan.amounts, line)
        cost = 0.0
        if len(others):
            cost = 2e-12 * least_squares(misfit, start, diff_step=1e-3).cost
        else:
            cost = total(case, known.identified, known.identified) ** 2
        least_unknown = unknown * 0.5  # a line fewer adds less of the fitter's error
        assert np.sqrt(cost + least_unknown) > 1.05 * after


def test_realised_accuracy_is_that_predicted():
    case = A3
    realised = adjust_machines(case, 4, seed=1)
    assert_worth_its_lines(realised)
    assert np.median([r.ratio for r in realised]) < 1.15
    gains = [r.before / (r.ratio * r.plan.accuracy[-1].total) for r in realised]
    assert np.median(gains) > 3.0
    assert_no_line_is_idle(case, min(realised, key=lambda r: len(r.plan.parameters)))
