"""Which parameters of a machine to adjust, and by how many steps of what moves them.

The machine has parameters p + delta, p identified, delta ~ N(0, Sigma). A fitter moves
the parameters of a list S by amounts a, each with an error of standard deviation s_j.
Software then compensates p + a. What it leaves is, to first order,

    known(p) + R a + A (delta + errors)        (R: `remaining`, A: `raw`),

where R is zero for what the drives correct. The mean square over the posterior, the
fitter's errors and the workspace, of components with weights, is the loss

    |known + R a|^2 + tr(A Sigma A^T) + sum over S of s_j^2 |A_j|^2.

Greedy forward selection and backward elimination, with all amounts fitted again at each
step, give a list of each length. Amounts are rounded to steps, then improved by one step
of one or two lines at a time. The shortest list within `WORTH_SHARE` of the best is taken;
lines that are worth less than that are removed. All is linear about the adjusted machine,
and repeated until the list stays the same.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.optimize import lsq_linear

from oed.accuracy import ErrorMaps, Reference, driven_errors
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Adjustment, Parameter

#: share of the error by which it must grow without a line that is worth its work
WORTH_SHARE = 0.05
MAX_ROUNDS = 6  #: rounds of linearisation about the adjusted machine
MAX_MOVES = 8  #: moves by a step, at most, for each line: rounding is nearly best
#: largest amount where none is stated, in tolerances of the parameter
MAX_TOLERANCES = 4.0
#: amounts (m, rad) of what is turned continuously are rounded to this
AMOUNT_STEP = 1e-6


@dataclasses.dataclass(frozen=True)
class StepProblem:
    """Amounts of m adjustments that make N weighted errors small."""

    errors: Array  #: (N,) errors without adjustments
    gradients: Array  #: (N, m) by each amount
    floor: float  #: mean square of what no adjustment changes
    scatter: Array  #: (m,) mean square that the fitter's error of each adjustment adds
    step: Array  #: (m,) smallest amounts
    most: Array  #: (m,) largest amounts to either side

    def size(self, amounts: Array) -> float:
        """Root mean square error with amounts (m,)."""
        left_over = self.errors + self.gradients @ amounts
        added = self.scatter[amounts != 0.0].sum()
        return float(np.sqrt(left_over @ left_over + added + self.floor))

    def fit(self, chosen: Sequence[int]) -> Array:
        """Best amounts (m,) of the chosen adjustments, within their limits."""
        amounts = np.zeros(len(self.step))
        if chosen:
            indices = list(chosen)
            limits = (-self.most[indices], self.most[indices])
            amounts[indices] = lsq_linear(
                self.gradients[:, indices], -self.errors, limits
            ).x
        return amounts

    def fit_steps(self, chosen: Sequence[int]) -> Array:
        """As `fit`, in whole steps: rounded, then improved by one or two steps at once."""
        limit = np.floor(self.most / self.step * (1.0 + 1e-12))
        steps = np.clip(np.rint(self.fit(chosen) / self.step), -limit, limit)
        columns = self.gradients * self.step
        gram = columns.T @ columns
        moves = _moves(chosen, len(steps))
        curvature = np.einsum("ij,jk,ik->i", moves, gram, moves)
        least = -1e-9 * self.size(np.zeros(len(steps))) ** 2
        for _ in range(MAX_MOVES * len(chosen)):
            gradient = columns.T @ (self.errors + columns @ steps)
            change = 2.0 * moves @ gradient + curvature
            change[(np.abs(steps + moves) > limit).any(axis=1)] = np.inf
            best = int(np.argmin(change))
            if change[best] >= least:
                break
            steps = steps + moves[best]
        return np.asarray(steps * self.step)


def _moves(chosen: Sequence[int], size: int) -> Array:
    """Moves (n, size) of one and of two chosen adjustments by a step."""
    unit = np.eye(size)
    signed = [sign * unit[j] for j in chosen for sign in (1.0, -1.0)]
    pairs = [a + b for a, b in itertools.combinations(signed, 2) if (a + b).any()]
    return np.array(signed + pairs).reshape(-1, size)


def choose_steps(problem: StepProblem) -> Array:
    """Amounts (m,) of the shortest list of adjustments that is worth its work."""
    lists = [*_growing(problem), *_shrinking(problem)]
    fitted = [problem.fit_steps(chosen) for chosen in lists]
    sizes = np.array([problem.size(amounts) for amounts in fitted])
    good = np.flatnonzero(sizes <= (1.0 + WORTH_SHARE) * sizes.min())
    best = min(good, key=lambda k: (len(lists[k]), sizes[k]))
    return _drop_idle_lines(problem, _swapped(problem, fitted[best]))


def sizes_without(problem: StepProblem, amounts: Array) -> Array:
    """Errors (lines,) where one line is left out and the others are fitted again."""
    lines = np.flatnonzero(amounts).tolist()
    return np.array([problem.size(_dropped(problem, lines, j)) for j in lines])


def _dropped(problem: StepProblem, lines: list[int], line: int) -> Array:
    return problem.fit_steps([j for j in lines if j != line])


def _drop_idle_lines(problem: StepProblem, amounts: Array) -> Array:
    """Remove the line that is worth least while it is not worth its work."""
    while amounts.any():
        lines = np.flatnonzero(amounts).tolist()
        sizes = sizes_without(problem, amounts)
        least = int(np.argmin(sizes))
        if sizes[least] > (1.0 + WORTH_SHARE) * problem.size(amounts):
            break
        amounts = _dropped(problem, lines, lines[least])
    return amounts


def _swapped(problem: StepProblem, amounts: Array) -> Array:
    """Replace one line by another as long as that makes the error smaller."""
    while True:
        lines = np.flatnonzero(amounts).tolist()
        others = [j for j in range(len(amounts)) if j not in lines]
        lists = [[*(k for k in lines if k != j), new] for j in lines for new in others]
        best = _smallest(problem, lists)
        swapped = amounts if best is None else problem.fit_steps(best)
        if problem.size(swapped) >= problem.size(amounts):
            return amounts
        amounts = swapped


def _growing(problem: StepProblem) -> Iterable[list[int]]:
    """Lists by forward selection, the empty one first."""
    chosen: list[int] | None = []
    while chosen is not None:
        yield chosen
        others = [j for j in range(len(problem.step)) if j not in chosen]
        chosen = _smallest(problem, [[*chosen, j] for j in others])


def _shrinking(problem: StepProblem) -> Iterable[list[int]]:
    """Lists by backward elimination, from all adjustments."""
    chosen: list[int] | None = list(range(len(problem.step)))
    while chosen:
        yield chosen
        chosen = _smallest(problem, [[k for k in chosen if k != j] for j in chosen])


def _smallest(problem: StepProblem, lists: list[list[int]]) -> list[int] | None:
    """The list with the smallest error; None without any."""
    if not lists:
        return None
    return min(lists, key=lambda chosen: problem.size(problem.fit(chosen)))


# -- machines --------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class AdjustedAccuracy:
    """Root mean square errors of a machine over the workspace, SI."""

    total: float  #: of all components with their weights, after compensation
    #: (k,) of each component, after software compensates the parameters
    corrected: Array
    plain: Array  #: (k,) with a controller that keeps the nominal parameters


@dataclasses.dataclass(frozen=True)
class AdjustmentPlan:
    """Lines of what to adjust, in order."""

    parameters: tuple[int, ...]  #: (lines,) numbers of the machine's parameters
    amounts: Array  #: (lines,) SI
    #: (lines,) total error where a line is left out and the others are fitted
    without: Array
    accuracy: tuple[AdjustedAccuracy, ...]  #: before the first line, and after each


@dataclasses.dataclass(frozen=True)
class AdjustableMachine:
    """What is known of a machine, and where its accuracy counts."""

    kinematics: Kinematics
    command: Array  #: (n, n_dof) workspace commands, SI
    reference: Reference  #: against which errors are stated
    identified: Array  #: (np,) parameters, SI
    covariance: Array  #: (np, np) of what the identification leaves unknown
    weights: Array  #: (k,) of the components in the total error

    @property
    def adjustable(self) -> list[int]:
        """Numbers of the parameters that something moves; frames are conventions."""
        machine = self.kinematics.machine
        return [
            k
            for k, p in enumerate(machine.parameters)
            if p.adjust is not None and p.name not in machine.frame
        ]

    def plan(self) -> AdjustmentPlan:
        """What to adjust. Raises AssemblyError."""
        columns = self.adjustable
        amounts = np.zeros(len(columns))
        for _ in range(MAX_ROUNDS):
            problem = self._problem(columns, amounts)
            before, amounts = amounts, choose_steps(problem)
            if np.array_equal(before, amounts):
                break
        lines = _line_order(problem, amounts)
        without = dict(
            zip(np.flatnonzero(amounts), sizes_without(problem, amounts), strict=True)
        )
        numbers = [columns[j] for j in lines]
        return AdjustmentPlan(
            parameters=tuple(numbers),
            amounts=amounts[lines],
            without=np.array([without[j] for j in lines]),
            accuracy=tuple(
                self.accuracy(numbers[:k], amounts[lines[:k]])
                for k in range(len(lines) + 1)
            ),
        )

    def accuracy(self, numbers: Sequence[int], amounts: Array) -> AdjustedAccuracy:
        """Accuracy once parameters of these numbers are moved by amounts, SI."""
        indices = list(numbers)
        parameters = self.identified.copy()
        parameters[indices] += amounts
        machine = self.kinematics.machine
        covariance = self.covariance.copy()
        covariance[indices, indices] += self._errors(indices) ** 2
        here = (self.kinematics, self.command, parameters, self.reference)
        corrected = driven_errors(*here, believed=parameters)
        plain = driven_errors(*here, believed=machine.nominal)
        raw = self._maps(parameters)[0]
        variance = np.einsum("nkp,pq,nkq->k", raw, covariance, raw, optimize=True)
        variance /= len(self.command)
        mean_square = np.mean(corrected**2, axis=0) + variance
        return AdjustedAccuracy(
            total=float(np.sqrt(self.weights**2 @ mean_square)),
            corrected=np.sqrt(mean_square),
            plain=np.sqrt(np.mean(plain**2, axis=0) + variance),
        )

    def _maps(self, parameters: Array) -> tuple[Array, Array]:
        """Slopes (n, k, np) raw and remaining, about parameters (np,)."""
        maps = ErrorMaps.of(
            self.kinematics, self.command, self.reference, parameters=parameters
        )
        return maps.raw, maps.remaining

    def _errors(self, numbers: Sequence[int]) -> Array:
        """Standard deviations of the fitter's errors, SI."""
        return self._each(numbers, lambda p, a: a.error)

    def _each(
        self, numbers: Sequence[int], value: Callable[[Parameter, Adjustment], float]
    ) -> Array:
        """A number of the adjustment of each parameter."""
        parameters = [self.kinematics.machine.parameters[k] for k in numbers]
        return np.array([value(p, p.adjust) for p in parameters if p.adjust])

    def _problem(self, columns: list[int], amounts: Array) -> StepProblem:
        """The problem, linear about the machine with amounts of its adjustments."""
        parameters = self.identified.copy()
        parameters[columns] += amounts
        here = (self.kinematics, self.command, parameters, self.reference)
        weights = self.weights[:, None] / np.sqrt(len(self.command))
        errors = driven_errors(*here, believed=parameters) * weights[:, 0]
        raw, remaining = (gradient * weights for gradient in self._maps(parameters))
        floor = np.einsum("nkp,pq,nkq->", raw, self.covariance, raw, optimize=True)
        gradients = remaining[:, :, columns].reshape(errors.size, len(columns))
        squares = np.sum(raw[:, :, columns] ** 2, axis=(0, 1))
        return StepProblem(
            errors=errors.ravel() - gradients @ amounts,
            gradients=gradients,
            floor=float(floor),
            scatter=self._errors(columns) ** 2 * squares,
            step=self._each(columns, lambda p, a: a.step or AMOUNT_STEP),
            most=self._each(
                columns, lambda p, a: a.most or MAX_TOLERANCES * p.tolerance
            ),
        )


def _line_order(problem: StepProblem, amounts: Array) -> list[int]:
    """Numbers of the lines: each next one leaves the smallest error."""
    waiting = np.flatnonzero(amounts).tolist()
    lines: list[int] = []
    moved = np.zeros_like(amounts)

    def size_with(line: int) -> float:
        return problem.size(np.where(np.arange(len(moved)) == line, amounts, moved))

    while waiting:
        best = min(waiting, key=size_with)
        waiting.remove(best)
        moved[best] = amounts[best]
        lines.append(best)
    return lines
