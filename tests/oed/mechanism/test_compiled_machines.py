"""Machines compiled and not: the same digits of poses, failures, slopes, readings."""

import numpy as np
import pytest
from shipped_models import five_bar, linear_delta

from kernel.cases import CASES
from kernel.mechanism.compiling import (
    both,
    compiled,
    compiled_files,
    needs_compiler,
    not_compiled,
)
from oed.measurement import Measurement
from oed.mechanism import AssemblyError, Kinematics
from oed.mechanism import compiled as lanes
from oed.mechanism.newton import STEP_TOLERANCE

__all__ = ["compiled_files"]
pytestmark = [needs_compiler, pytest.mark.usefixtures("compiled_files")]

COUNTS = (1, 7, 8, 9, 192, 1000)
#: one machine with a pivot of its own at each pose, one with square roots alone
MACHINES = {"five_bar": five_bar.machine, "linear_delta": linear_delta.machine}


def reached(kinematics, rng, count):
    """Poses and joints of random commands around home, as far as all are in reach."""
    machine = kinematics.machine
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    home = machine.home_command
    change = rng.uniform(lower, upper, (count, len(lower))) - home
    for share in (0.3, 0.05):
        try:
            return kinematics.inverse(home + share * change)
        except AssemblyError:
            continue
    raise AssertionError(machine.name)


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_has_the_same_digits_compiled(name, rng):
    machine = MACHINES[name]
    fast, plain = both(lambda: Kinematics(machine))
    x, q = reached(plain, rng, max(COUNTS))
    tolerance = np.array([p.tolerance for p in machine.parameters])
    p = machine.nominal + tolerance * rng.standard_normal((len(q), len(tolerance)))
    lost = rng.random(len(q)) < 0.05
    lost[0] = False
    q[lost] += machine.lever * rng.uniform(-3.0, 3.0, (lost.sum(), q.shape[1]))
    q[6] = np.nan

    def poses(kinematics: Kinematics, n: int) -> tuple[np.ndarray, np.ndarray]:
        return kinematics.equations.solve((x[:n], q[:n], p[:n]), STEP_TOLERANCE)

    for n in COUNTS:
        wanted, fails = not_compiled(lambda n=n: poses(plain, n))
        solved, failed = compiled(lambda n=n: poses(fast, n))
        np.testing.assert_array_equal(failed, fails)
        np.testing.assert_array_equal(solved[~fails], wanted[~fails])
    assert fast.equations.equations._jobs[lanes.Newton].ready is not None

    at = solved[~failed], q[~failed], p[~failed]
    slopes = rng.standard_normal((len(at[0]), 2, x.shape[1]))
    for one, two in zip(
        compiled(lambda: fast.slopes.pull_back(*at, slopes)),
        not_compiled(lambda: plain.slopes.pull_back(*at, slopes)),
        strict=True,
    ):
        np.testing.assert_array_equal(one, two)
    rows, bounds = plain.slopes.pull_back(*at, slopes)
    by_x, by_p, _ = plain.equations.slopes(*at)
    direct = slopes @ -np.linalg.solve(by_x, by_p)
    error = np.abs(rows - direct).max(axis=(1, 2)) / np.abs(direct).max(axis=(1, 2))
    assert (error < 1e-14 * np.maximum(bounds, 10.0)).all()
    exact = np.linalg.cond(by_x * plain.slopes._scale)
    assert (bounds >= exact * (1.0 - 1e-9)).all()


def test_readings_and_their_slopes_have_the_same_digits_compiled(rng):
    """Of two channels, and of a pose against that of its run."""
    case = CASES["planar_2dof"]
    setups = [case.setups["rm1"]]
    fast, plain = both(lambda: Measurement(case.machine, setups))
    command = case.commands(rng, 40)
    series = plain.series("rm1", command, run=[str(i // 8) for i in range(40)])
    theta = plain.nominal + plain.tolerance * rng.standard_normal(
        (9, len(plain.nominal))
    )
    for vectors in (theta[0], theta):
        for compute in ("readings", "jacobian"):
            values = compiled(
                lambda c=compute, v=vectors: getattr(fast, c)([series], v)
            )
            wanted = not_compiled(
                lambda c=compute, v=vectors: getattr(plain, c)([series], v)
            )
            np.testing.assert_array_equal(values, wanted)


@pytest.mark.parametrize("n", [3, 300])
def test_poses_out_of_reach_are_reported_alike(n):
    machine = MACHINES["linear_delta"]
    reports = []
    for build in (not_compiled, compiled):
        kinematics = build(lambda: Kinematics(machine))
        x, q = kinematics.inverse(np.tile(machine.home_command, (n, 1)))
        q[1] += [0.0, 0.0, 50.0 * machine.lever]
        with pytest.raises(AssemblyError) as raised:
            build(lambda k=kinematics, q=q, x=x: k.forward(q, machine.nominal, x))
        reports.append(str(raised.value))
    assert reports[0] == reports[1]
    assert "1 of" in reports[0]
    assert "pose numbers 1" in reports[0]
