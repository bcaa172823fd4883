"""One stage of a plan: its readings, its time, and the knowledge that it leaves.

A machine that is far off loses nearly all readings, and will lose those of the next
stage as well. Where readings can be lost, machines are drawn, and
each carries its own covariance and error. The linearisation residual is estimated from
the exact model and profiled out too.

With d and u the errors of machine and set-up before a stage, and e the noise of its
readings, all unknowns but d profiled out, the stage leaves the error

    d' = S' (S^-1 d - K u - v),    S' = (S^-1 + M)^-1,    v ~ N(0, M - K K^T).

v holds the noise, and unknowns that have no part in which readings are lost. Machines
which lose the same candidates share a pattern, and with it M and K. Machines of one
pattern and one covariance S are a group: they share S' as well.

With the information M over machine parameters m and other unknowns o, each of which is
N(0, 1) before, the readings add

    M_mm - M_mo (1 + M_oo)^-1 M_om = M_mm - K M_om

about the machine. K u is what known unknowns u change in its normal equations. What the
Jacobian misses of the exact model are columns of N(0, 1) unknowns: docs/theory/planning.md.
"""

import dataclasses
from functools import cached_property

import numpy as np

from oed.base import Array, Index, Mask
from oed.linear_algebra import symmetric_inverse, symmetric_root
from oed.measurement import Series
from oed.planning import travel
from oed.planning.knowledge import Knowledge, Prior, make_knowledge, multiply_each
from oed.planning.option import Option

#: share of a reading's noise below which its residual is neglected
NEGLIGIBLE_RESIDUAL = 0.02


@dataclasses.dataclass(frozen=True, eq=False)
class LinearisationResidual:
    """Residuals over drawn machines."""

    #: (readings,) over the machines that give the reading, SI; inf where none of them
    #: reaches the pose
    rms: Array
    #: (G, readings, m) whitened, for each pattern of captured candidates; None where
    #: all residuals are negligible
    columns: Array | None


def estimate_residual(
    option: Option,
    chosen: Index,
    posterior: Array,
    posterior_of: Index,
    patterns: Array,
    rng: np.random.Generator,
) -> LinearisationResidual:
    """Residuals of the chosen candidates (N), with machines drawn after the stage.

    posterior     (K, w, w) covariances of all unknowns after the stage
    posterior_of  (G x draws,) covariance of each machine to draw, pattern by pattern
    patterns      (G, N) captured candidates
    """
    measurement = option.measurement
    series = option.series_of(chosen)
    draws = len(posterior_of) // len(patterns)
    errors = _draw_errors(option, posterior, posterior_of, rng)
    candidate_of = np.repeat(np.arange(len(chosen)), reading_counts(option, chosen))
    captured = np.repeat(patterns[:, candidate_of] > 0.0, draws, axis=0)
    exact = measurement.try_readings(series, measurement.nominal + errors, captured)
    numbers = option.numbers_of(chosen)
    linear = option.nominal_readings[numbers] + errors @ option.jacobian[numbers].T
    residual = exact - linear
    valid = captured & np.isfinite(residual)
    residual_or_zero = np.where(valid, residual, 0.0)
    count = np.maximum(valid.sum(axis=0), 1)
    mean_square = np.sum(residual_or_zero**2, axis=0) / count
    unreachable = captured.any(axis=0) & ~valid.any(axis=0)
    rms = np.where(unreachable, np.inf, np.sqrt(mean_square))
    if not (rms > NEGLIGIBLE_RESIDUAL * measurement.sigma(series)).any():
        return LinearisationResidual(rms, None)
    white = whiten(option, chosen, residual_or_zero)
    return LinearisationResidual(rms, _columns(white, len(patterns), draws))


def _draw_errors(
    option: Option, posterior: Array, posterior_of: Index, rng: np.random.Generator
) -> Array:
    """Parameter errors (machines, p), SI, of machines drawn after the stage."""
    measurement = option.measurement
    normals = rng.standard_normal((len(posterior_of), posterior.shape[1]))
    scaled = multiply_each(symmetric_root(posterior), posterior_of, normals)
    free = np.flatnonzero(measurement.free)
    errors = np.zeros((len(scaled), len(measurement.nominal)))
    of_parameters = scaled[:, option.parameter_columns]
    errors[:, free] = of_parameters * measurement.tolerance[free]
    return errors


def _columns(white: Array, patterns: int, draws: int) -> Array:
    """Columns (G, readings, m) from whitened residuals (G x draws, readings)."""
    by_pattern = white.reshape(patterns, draws, -1)
    deviation = by_pattern - by_pattern.mean(axis=1, keepdims=True)
    rows = deviation / np.sqrt(draws - 1.0)
    # only R^T R counts, so the triangle has no more rows than there are readings
    if draws > rows.shape[2]:
        rows = np.linalg.qr(rows, mode="r")
    return np.ascontiguousarray(np.swapaxes(rows, 1, 2))


def reading_counts(option: Option, chosen: Index) -> Index:
    """Numbers (N,) that each chosen candidate reads, over all its channels."""
    candidates = option.candidates
    setups = option.measurement.setups
    channels = np.array([len(setups[name].sigma) for name in candidates.setups])
    counts = candidates.members[chosen, 1] * channels[candidates.setup[chosen]]
    return np.asarray(counts)


def whitened_rows(option: Option, chosen: Index) -> Array:
    """Whitened rows (readings, w) of the chosen blocks, in tolerance units."""
    measurement, candidates = option.measurement, option.candidates
    chosen_jacobian = option.jacobian[option.numbers_of(chosen)]
    jacobian = (chosen_jacobian * measurement.tolerance)[:, measurement.free]
    rows = np.zeros((len(jacobian), option.unknowns))
    rows[:, option.parameter_columns] = whiten(option, chosen, jacobian.T).T
    nuisances = candidates.nuisances
    if nuisances is not None:
        of_effects = nuisances.columns[option.numbers_of(chosen)]
        end = option.machine_columns
        rows[:, end - option.effects : end] = whiten(option, chosen, of_effects.T).T
    of_runs = candidates.shared_errors - option.effects
    if of_runs:
        # candidates are single readings, with rows of blocks
        counts = reading_counts(option, chosen)
        is_reading = np.arange(candidates.blocks.shape[1]) < counts[:, None]
        block_rows = candidates.blocks[chosen][is_reading]
        rows[:, -of_runs:] = block_rows[:, -of_runs:]
    return rows


def whiten(option: Option, chosen: Index, values: Array) -> Array:
    """Values (m, readings) whitened as the blocks: runs with their shared errors."""
    measurement = option.measurement
    series = option.series_of(chosen)
    weight = option.weight[option.numbers_of(chosen)]
    if (option.candidates.members[:, 1] > 1).any():
        return measurement.noise(series).whiten_last(values) * weight
    parts = []
    start = 0
    for s in series:
        root = np.linalg.cholesky(measurement.of(s).reading_covariances(s))
        n, k = root.shape[:2]
        part = values[:, start : start + n * k].reshape(-1, n, k)
        white = np.linalg.solve(root, part.transpose(1, 2, 0))
        parts.append(white.transpose(2, 0, 1).reshape(len(values), -1))
        start += n * k
    return np.hstack(parts) * weight


@dataclasses.dataclass(frozen=True, eq=False)
class ProfiledInformation:
    """Information of each pattern (G) of captured candidates."""

    machine: Array  #: (G, n, n) about the machine's parameters
    by_setup: Array  #: (G, n, s) columns of K for the set-ups' unknowns

    @property
    def noise(self) -> Array:
        """Covariance (G, n, n) of the normal equations where the set-ups are known."""
        by_setup = self.by_setup
        return self.machine - by_setup @ np.swapaxes(by_setup, 1, 2)


def profile(information: Array, columns: int, unknowns: int) -> ProfiledInformation:
    """Profile out what is not the machine's.

    information  (G, w, w) over the machine's parameters (the first `columns`), the
                 set-ups' unknowns (up to `unknowns`), and others
    """
    of_machine = information[:, :columns, :columns]
    others = information.shape[1] - columns
    if not others:
        none = np.zeros((len(information), columns, 0))
        return ProfiledInformation(of_machine, none)
    mixed = information[:, columns:, :columns]
    of_others = information[:, columns:, columns:] + np.eye(others)
    gain = np.swapaxes(np.linalg.solve(of_others, mixed), 1, 2)
    profiled = of_machine - gain @ mixed
    symmetric = 0.5 * (profiled + np.swapaxes(profiled, 1, 2))
    return ProfiledInformation(symmetric, gain[:, :, : unknowns - columns])


CERTAIN_PROBABILITY = 0.999  #: capture probability from which no machines are drawn


@dataclasses.dataclass(frozen=True, eq=False)
class DrawnMachines:
    """Machines (P) before a stage."""

    #: before the stage; `lost_readings` are those up to this stage
    knowledge: Knowledge
    #: (P, s) of the set-ups' parameters and of errors that runs share
    setup_errors: Array
    patterns: Array  #: (G, N) captured candidates, 1 or 0
    pattern_of: Index  #: (P,) pattern of each machine

    @property
    def group_of(self) -> Index:
        """Group (P,) of each machine."""
        return self._groups[1]

    def joint_posterior(self, information: Array, groups: Index) -> Array:
        """Covariances (K, w, w) in groups (K,), of information (G, w, w) a pattern."""
        covariance_of, pattern_of = self._groups[0]
        total = information[pattern_of[groups]] + np.eye(information.shape[1])
        n = self.knowledge.covariances.shape[1]
        total[:, :n, :n] += self._prior_information[covariance_of[groups]] - np.eye(n)
        return _inverses(total)

    def update(
        self, information: ProfiledInformation, rng: np.random.Generator
    ) -> Knowledge:
        """Knowledge after readings with this information of each pattern."""
        covariance_of, pattern_of = self._groups[0]
        prior = self._prior_information[covariance_of]
        covariances = _inverses(prior + information.machine[pattern_of])
        before, lost = self.knowledge.errors, self.knowledge.lost_readings
        no_loss = ~lost
        errors = None
        if before is None:
            no_loss = np.ones(len(self.group_of), dtype=bool)
        total = self._sum(covariances, no_loss)
        if before is not None:
            noise = information.noise
            known_errors = self._known_part(before, information)
            normals = rng.standard_normal(before.shape)
            drawn = multiply_each(symmetric_root(noise), self.pattern_of, normals)
            errors = multiply_each(covariances, self.group_of, known_errors - drawn)
            # A machine without losses has the error of its covariance. One with losses
            # is farther off: its mean square over the noise counts.
            bias = multiply_each(covariances, self.group_of[lost], known_errors[lost])
            scatter = covariances @ noise[pattern_of] @ covariances
            total = total + self._sum(scatter, lost) + bias.T @ bias
        return Knowledge(
            covariances=covariances,
            covariance_of=self.group_of,
            errors=errors,
            lost_readings=lost,
            mean_square_error=total / len(self.group_of),
        )

    @cached_property
    def _groups(self) -> tuple[tuple[Index, Index], Index]:
        """Covariance and pattern (K,) of each group, and each machine's group (P,)."""
        patterns = len(self.patterns)
        number = self.knowledge.covariance_of * patterns + self.pattern_of
        groups, group_of = np.unique(number, return_inverse=True)
        return (groups // patterns, groups % patterns), group_of

    @cached_property
    def _prior_information(self) -> Array:
        """S^-1 (Q, n, n)."""
        return np.asarray(np.linalg.inv(self.knowledge.covariances))

    def _known_part(self, errors: Array, information: ProfiledInformation) -> Array:
        """S^-1 d - K u (P, n) for errors d (P, n)."""
        of_machine = multiply_each(
            self._prior_information, self.knowledge.covariance_of, errors
        )
        by_setup = information.by_setup
        return of_machine - multiply_each(by_setup, self.pattern_of, self.setup_errors)

    def _sum(self, matrices: Array, of: Mask) -> Array:
        """Sum (n, n) of the groups' matrices (K, n, n) over some machines (P,)."""
        counts = np.bincount(self.group_of[of], minlength=len(matrices))
        return np.tensordot(counts, matrices, 1)


def _inverses(matrices: Array) -> Array:
    inverted = np.linalg.inv(matrices)
    return np.asarray(0.5 * (inverted + np.swapaxes(inverted, 1, 2)))


def draw_machines(
    option: Option,
    chosen: Index,
    knowledge: Knowledge,
    probability: Array,
    draws: int,
    rng: np.random.Generator,
) -> DrawnMachines:
    """Machines of `knowledge`; `draws` of them where a probability (N,) is below 1."""
    extra = option.unknowns - knowledge.columns
    if not option.limits_travel or probability.min() >= CERTAIN_PROBABILITY:
        return _all_captured(knowledge, extra, len(chosen), rng)
    drawn = knowledge.repeat(max(draws // knowledge.machines, 1))
    errors = drawn.draw_errors(rng)
    setup_errors = rng.standard_normal((drawn.machines, extra))
    of_setups = setup_errors[:, : option.setup_columns]
    captured = travel.is_captured(option, chosen, errors, of_setups)
    lost = drawn.lost_readings | ~captured.all(axis=1)
    patterns, pattern_of = np.unique(captured, axis=0, return_inverse=True)
    return DrawnMachines(
        knowledge=dataclasses.replace(drawn, errors=errors, lost_readings=lost),
        setup_errors=setup_errors,
        patterns=patterns.astype(float),
        pattern_of=pattern_of.ravel(),
    )


def _all_captured(
    knowledge: Knowledge, extra: int, chosen: int, rng: np.random.Generator
) -> DrawnMachines:
    """The machines of `knowledge`, all of which give all chosen candidates."""
    drawn = knowledge.machines if knowledge.errors is not None else 0
    return DrawnMachines(
        knowledge=knowledge,
        setup_errors=rng.standard_normal((drawn, extra)),
        patterns=np.ones((1, chosen)),
        pattern_of=np.zeros(knowledge.machines, dtype=np.intp),
    )


MACHINE_DRAWS = 48  #: number of machines drawn where readings can be lost
FIRST_LOOK_DRAWS = 12  #: the same for a first look at a partial plan
#: number of machines drawn for the linearisation residual, at the most
RESIDUAL_DRAWS = 96
#: the same for each pattern of captures, at the least: two give no mean
MIN_RESIDUAL_DRAWS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class PlanStage:
    """One stage."""

    option: Option  #: the measurement
    chosen: Index  #: (N,) chosen candidates, ascending
    seconds: float  #: time for mounting and reading
    probability: Array  #: (N,) that each chosen candidate is captured
    #: (readings,) residual after the stage, SI; empty: not estimated
    linearisation_rms: Array
    posterior: Knowledge  #: knowledge of the machine after the stage
    information: Array  #: (n, n) that the stage adds

    @property
    def covariance(self) -> Array:
        """Mean square errors (n, n) of the parameters after it, in tolerance units."""
        return self.posterior.mean_square_error

    @property
    def series(self) -> tuple[Series, ...]:
        """The readings to take."""
        return self.option.series_of(self.chosen)

    @property
    def lost_share(self) -> float:
        """Expected share of the chosen candidates that are lost."""
        return float(1.0 - self.probability.mean())


def predict_stage(
    option: Option,
    chosen: Index,
    prior: Prior,
    probability: Array,
    rng: np.random.Generator,
    exact: bool = True,
    draws: int | None = None,
) -> PlanStage:
    """Predict what a stage with the chosen candidates leaves, of probability (C,).

    exact  False: a first look, with few machines and no linearisation residual
    draws  machines drawn where readings can be lost; half for the residual
    """
    chosen = np.sort(chosen)
    knowledge = make_knowledge(prior)
    chosen_probability = probability[chosen]
    draws = (draws or MACHINE_DRAWS) if exact else FIRST_LOOK_DRAWS
    machines = draw_machines(option, chosen, knowledge, chosen_probability, draws, rng)
    information = _information(option, chosen, machines.patterns)
    rms = np.zeros(0)
    if exact:
        residual = _residual(option, chosen, machines, information, draws, rng)
        rms = residual.rms
        if residual.columns is not None:
            information = _information_with_residual(
                option, chosen, machines.patterns, rms, residual.columns
            )
    profiled = profile(information, knowledge.columns, option.unknowns)
    posterior = machines.update(profiled, rng)
    after = symmetric_inverse(posterior.mean_square_error)
    before = symmetric_inverse(knowledge.mean_square_error)
    return PlanStage(
        option=option,
        chosen=chosen,
        seconds=option.mounting_seconds + float(option.candidate_seconds[chosen].sum()),
        probability=chosen_probability,
        linearisation_rms=rms,
        posterior=posterior,
        information=_positive_part(after - before),
    )


def _positive_part(matrix: Array) -> Array:
    """The nearest positive semidefinite matrix.

    Machines that lose readings can be farther off after a stage than all machines were
    before. A difference of information would then be negative in some directions.
    """
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _information(option: Option, chosen: Index, patterns: Array) -> Array:
    """Information (G, w, w) about all unknowns of each pattern (G, N) of captures."""
    blocks = option.candidates.blocks[chosen]
    rows = blocks.reshape(-1, blocks.shape[2])
    candidate_of = np.repeat(np.arange(len(chosen)), blocks.shape[1])
    captured = patterns[:, candidate_of] > 0.0
    return np.array([_gram(rows[mask]) for mask in captured])


def _residual(
    option: Option,
    chosen: Index,
    machines: DrawnMachines,
    information: Array,
    draws: int,
    rng: np.random.Generator,
) -> LinearisationResidual:
    """Linearisation residual with half of the draws, shared among the patterns."""
    per_pattern = min(draws // 2, RESIDUAL_DRAWS) // len(machines.patterns)
    count = max(per_pattern, MIN_RESIDUAL_DRAWS)
    drawn = [
        np.resize(np.flatnonzero(machines.pattern_of == pattern), count)
        for pattern in range(len(machines.patterns))
    ]
    groups = machines.group_of[np.concatenate(drawn)]
    needed, posterior_of = np.unique(groups, return_inverse=True)
    return estimate_residual(
        option,
        chosen,
        machines.joint_posterior(information, needed),
        posterior_of,
        machines.patterns,
        rng,
    )


def _information_with_residual(
    option: Option, chosen: Index, patterns: Array, rms: Array, columns: Array
) -> Array:
    """Information (G, w + m, w + m) with residuals' columns; rms (readings,), SI."""
    rows = whitened_rows(option, chosen)
    counts = reading_counts(option, chosen)
    candidate_of = np.repeat(np.arange(len(chosen)), counts)
    reachable = np.isfinite(rms)
    grams = []
    for pattern, of_pattern in zip(patterns, columns, strict=True):
        captured = (pattern[candidate_of] > 0.0) & reachable
        grams.append(_gram(np.hstack([rows, of_pattern])[captured]))
    return np.array(grams)


def _gram(rows: Array) -> Array:
    return rows.T @ rows
