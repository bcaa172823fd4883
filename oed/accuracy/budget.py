"""Uncertainty budget: what each source adds to the errors of the compensated machine.

In units of the tolerances the errors of the estimate are S H^T C^-1 e - S z, with
S = (I + H^T C^-1 H)^-1, the readings' errors e and the parameters' z. Sources that the
estimate has to guard against are taken away one after the other: the unknowns of the
set-ups, the sizes of effects, the errors that runs share, noise beyond the stated one.
Each makes S smaller; what it costs is its line, though an estimate that guards against
it may pass little of it on. What stays has the instruments' noise alone, and

    S = sum_j S H^T C^-1 C_j C^-1 H S + S S,        C = sum_j C_j over instruments.

The last part comes from the tolerances. Along an eigenvector of H^T C^-1 H with
eigenvalue g it is 1 / (1 + g)^2: readings that tell less than the drawing, g < 1, leave
that combination undetermined.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from oed.accuracy.maps import ErrorMaps, Reference, raw_maps_of_machines
from oed.base import Array, Index, Mask
from oed.measurement import Measurement, Series, draw_parameters, reading_structure
from oed.mechanism import NO_TOOL, AssemblyError
from oed.noise import Errors, Laws, LinearFactor, ReadingStructure, SharedError

# Errors of readings that add up to their noise under a law, each with a name.
#
# The stated noise is the instrument's. A scale above 1 is noise beyond its statement. What
# a run's readings share (level, stated shared error, a set-up seated anew, an error carried
# along) are run-to-run errors.

BEYOND = "noise beyond the stated one"  #: names of the errors of readings
COURSE = "drift through the session"
LEVELS = "run-to-run level"
SHARED = "error shared by a run"
SEAT = "set-up seated anew"
CARRIED = "correlated noise of a run"
#: kinds of the errors that a run shares, by name
SHARED_KINDS = {
    LEVELS: (SharedError.LEVEL,),
    SHARED: (SharedError.KNOWN, SharedError.STATED_LEVEL),
    SEAT: (SharedError.RENEWED, SharedError.STATED_SEAT),
}


def instrument_source(name: str) -> str:
    """Name of the noise that an instrument states."""
    return f"noise of {name}"


@dataclasses.dataclass(frozen=True, eq=False)
class ReadingErrors:
    """Errors of N readings that add up, each with a factor on its standard deviation."""

    whole: Errors  #: all errors together, in units of the stated noise
    variances: Mapping[str, Array]  #: {error: (N,)} of errors that are independent
    shared: Mapping[str, Index]  #: {error: (K,) columns of `whole.shared`}
    names: tuple[str, ...]  #: of all errors

    def factor(self, factors: Mapping[str, float]) -> LinearFactor:
        """Root of the sum, each standard deviation times its factor (1 by default)."""
        whole = self.whole
        terms = [factors.get(n, 1.0) ** 2 * v for n, v in self.variances.items()]
        variance = np.sum(terms, axis=0)[whole.order]
        amounts = np.ones(whole.shared.shape[1])
        for name, columns in self.shared.items():
            amounts[columns] = factors.get(name, 1.0)
        correlated = factors.get(CARRIED, 1.0) ** 2 * whole.correlated
        changed = dataclasses.replace(
            whole,
            single=variance / whole.scale**2,
            correlated=correlated,
            decay=whole.decay if correlated.any() else np.zeros(len(whole.decay)),
            shared=(whole.shared * amounts)[:, amounts > 0.0],
        )
        return LinearFactor(changed)

    def whiten(self, values: Array, factors: Mapping[str, float]) -> Array:
        """W Y (N, m), in an order of its own, with W C W^T = 1, for Y (N, m)."""
        return self.factor(factors).whiten(values)

    def weigh(self, values: Array, factors: Mapping[str, float]) -> Array:
        """C^-1 Y (N, m), for Y (N, m)."""
        return self.factor(factors).precision(values)

    def between(self, name: str, weighed: Array) -> Array:
        """K^T C_j K (n, n) of one independent error, for K (N, n)."""
        return weighed.T @ (weighed * self.variances[name][:, None])


def errors_of_readings(
    structure: ReadingStructure, laws: Laws, instruments: Sequence[str]
) -> ReadingErrors:
    """Errors under the first of the laws, by each reading's instrument (N,)."""
    names, whole = np.asarray(instruments), laws.errors(structure)
    scale = laws.scale[0, structure.group]
    single = (1.0 - laws.correlated[0]) * scale**2
    stated = np.minimum(single, 1.0)
    variances = {
        instrument_source(name): np.where(names == name, stated, 0.0)
        for name in dict.fromkeys(instruments)
    }
    if (single > 1.0).any():
        variances[BEYOND] = single - stated
    errors = ReadingErrors(
        whole, variances, _columns_by_name(structure, laws, whole), ()
    )
    return dataclasses.replace(errors, names=_names(structure, errors))


def _columns_by_name(
    structure: ReadingStructure, laws: Laws, whole: Errors
) -> dict[str, Index]:
    """Columns of `whole.shared` that each shared error has."""
    terms = len(structure.course.T) if laws.course[0] else 0
    of_runs = whole.shared.shape[1] - terms
    repeats = of_runs // max(len(structure.kinds), 1)
    kinds = np.tile(structure.kinds, repeats)
    amounts = laws.sizes[0, kinds]
    columns = {
        name: np.flatnonzero(np.isin(kinds, some) & (amounts > 0.0))
        for name, some in SHARED_KINDS.items()
    }
    columns[COURSE] = np.arange(of_runs, of_runs + terms)
    return {name: some for name, some in columns.items() if some.size}


def _names(structure: ReadingStructure, errors: ReadingErrors) -> tuple[str, ...]:
    """Names of the errors, in the order in which runs have them first."""
    run = structure.run[structure.chain]
    by_reading: dict[str, Mask] = {
        name: np.asarray(v > 0.0) for name, v in errors.variances.items()
    }
    for name, columns in errors.shared.items():
        has = np.zeros(len(structure), dtype=bool)
        has[errors.whole.order] = errors.whole.shared[:, columns].any(axis=1)
        by_reading[name] = has
    if errors.whole.correlated.any():
        by_reading[CARRIED] = np.ones(len(structure), dtype=bool)
    names: dict[str, None] = {}
    for number in np.unique(run):
        members = run == number
        names |= {n: None for n, has in by_reading.items() if has[members].any()}
    return tuple(names)


Kind = Literal["instrument", "run", "course", "noise law", "set-up", "effects", "prior"]
#: errors that are taken away in turn
TAKEN_AWAY: tuple[Kind, ...] = ("run", "course", "noise law")
SETUP = "unknown set-up"
EFFECTS = "sizes of the effects"
TOLERANCES = "pull of the tolerances"
LineKind = Kind | Literal["linearisation"]
#: factor on the standard deviation of an error that is taken away: its covariance stays
#: regular
REMOVAL_FACTOR = 1e-4
SHARE_TOLERANCE = 1e-10  #: share of the variance below which a line is rounding
N_MACHINES = 48  #: machines drawn for what linearisation leaves out
#: poses of all machines whose maps are computed at once: 200 MB with 100 parameters
MAX_POSES = 20_000


@dataclasses.dataclass(frozen=True, eq=False)
class CovariancePart:
    """A part of the covariance (k, k), SI, of the parameters that move the pose."""

    source: str
    kind: Kind
    covariance: Array


@dataclasses.dataclass(frozen=True, eq=False)
class BudgetModel:
    """Readings of n parameters, linear, with normal errors."""

    structure: ReadingStructure  #: of the readings
    slopes: Array  #: (N, n) in units of stated noise, over z ~ N(0, I) a priori
    readings: ReadingErrors  #: errors of the readings
    root: Array  #: (n, n) of the prior covariance, SI: parameters deviate by root z
    names: tuple[str, ...]  #: (n,) of the parameters
    instruments: tuple[str, ...]  #: of the readings, each once
    used: Index  #: (k,) the parameters that move the pose
    setup: Mask  #: (n,) which are unknowns of the set-ups
    effect: Mask  #: (n,) which are coefficients of effects

    @property
    def errors(self) -> dict[str, Kind]:
        """The readings' errors, and of which kind each is."""
        stated = {instrument_source(name) for name in self.instruments}
        kinds: dict[str, Kind] = dict.fromkeys(self.readings.names, "run")
        others: dict[str, Kind] = {COURSE: "course", BEYOND: "noise law"}
        others |= dict.fromkeys(stated, "instrument")
        return kinds | {n: kind for n, kind in others.items() if n in kinds}

    def information(self, factors: Mapping[str, float] | None = None) -> Array:
        """H^T C^-1 H (n, n), with factors on the standard deviations of errors."""
        white = self.readings.whiten(self.slopes, factors or {})
        return white.T @ white

    def covariance(
        self,
        factors: Mapping[str, float] | None = None,
        removed: Mask | None = None,
        prior: float = 1.0,
    ) -> Array:
        """Covariance (k, k), SI, of the used parameters.

        factors  on the standard deviations of the readings' errors, by name
        removed  (n,) parameters that are known
        prior    factor on the tolerances of the machine's parameters
        """
        scale = np.where(self.setup | self.effect, 1.0, prior)
        information = self.information(factors) * np.outer(scale, scale)
        covariance = _posterior(information, removed)
        return self._si_covariance(covariance * np.outer(scale, scale))

    def response(self, changes: Array) -> Array:
        """Change (k, m), SI, of the estimate by changes (N, m) of the readings, SI."""
        standard = self.structure.standardise(changes)
        score = self.slopes.T @ self.readings.weigh(standard, {})
        change = _posterior(self.information(), None) @ score
        return (self.root @ change)[self.used]

    def parts(self) -> list[CovariancePart]:
        """Parts that add up to `covariance()`; those that are nothing are absent."""
        information = self.information()
        whole = _posterior(information, None)
        parts: list[CovariancePart] = []
        removed = np.zeros(len(self.names), dtype=bool)
        gone: dict[str, float] = {}
        for source, kind, members in self._steps():
            if members is None:
                gone[source] = 0.0
                information = self.information(gone)
            else:
                removed = removed | members
            rest = _posterior(information, removed)
            parts.append(
                CovariancePart(source, kind, self._si_covariance(whole - rest))
            )
            whole = rest
        parts += self._instrument_parts(whole, gone)
        return parts + self._prior_parts(information, removed)

    def _steps(self) -> list[tuple[str, Kind, Mask | None]]:
        """What is taken away in turn: parameters that get known, or an error (None)."""
        steps: list[tuple[str, Kind, Mask | None]] = []
        if self.setup.any():
            steps.append((SETUP, "set-up", self.setup))
        if self.effect.any():
            steps.append((EFFECTS, "effects", self.effect))
        errors = self.errors
        for taken in TAKEN_AWAY:
            steps += [(n, kind, None) for n, kind in errors.items() if kind == taken]
        return steps

    def _instrument_parts(
        self, covariance: Array, gone: Mapping[str, float]
    ) -> list[CovariancePart]:
        """The stated noises through the estimate with this covariance (n, n)."""
        names = [n for n, kind in self.errors.items() if kind == "instrument"]
        weighed = self.readings.weigh(self.slopes, gone) @ covariance
        totals = [self.readings.between(name, weighed) for name in names]
        return [
            CovariancePart(name, "instrument", self._si_covariance(total))
            for name, total in zip(names, totals, strict=True)
        ]

    def _prior_parts(self, information: Array, removed: Mask) -> list[CovariancePart]:
        """The tolerances: what no reading determines, and their pull on the others."""
        free = np.flatnonzero(~removed)
        gain, vectors = np.linalg.eigh(information[np.ix_(free, free)])
        weight = 1.0 / (1.0 + np.maximum(gain, 0.0)) ** 2
        parts = []
        for source, members in (
            ("combinations that no reading determines", gain < 1.0),
            (TOLERANCES, gain >= 1.0),
        ):
            if members.any():
                part = np.zeros_like(information)
                chosen = vectors[:, members]
                inner = (chosen * weight[members]) @ chosen.T
                part[np.ix_(free, free)] = inner
                parts.append(CovariancePart(source, "prior", self._si_covariance(part)))
        return parts

    def budget(
        self,
        maps: ErrorMaps,
        *,
        estimated: Array | None = None,
        predicted: Array | None = None,
    ) -> "Budget":
        """The budget of errors `maps.raw` (n, k, p) @ delta.

        estimated  covariance (p, p), SI; that of the readings by default
        predicted  (k,) mean variance that is predicted with what is not linear, SI
        """
        products = mean_products(maps.raw)
        lines = [_line(self, products, part) for part in self.parts()]
        variance = mean_variance(products, self.covariance())
        if estimated is not None:
            of_estimate = mean_variance(products, estimated)
            lines.append(Line("estimated noise", "noise law", of_estimate - variance))
            variance = of_estimate
        if predicted is not None:
            lines.append(Line("linearisation", "linearisation", predicted - variance))
            variance = predicted
        return Budget(maps.names, variance, _add_remainder(lines, variance))

    def _si_covariance(self, covariance: Array) -> Array:
        """The used parameters' block (k, k), SI, of a covariance (n, n) of z."""
        rows = self.root[self.used]
        return rows @ covariance @ rows.T

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        series: Sequence[Series],
        theta: Array,
        *,
        laws: Laws | None = None,
        coefficients: int = 0,
    ) -> "BudgetModel":
        """The model of readings linearised at theta (n,), SI.

        laws          noise law, the first of which counts; as stated by default
        coefficients  number of coefficients of effects at the end of theta
        """
        structure = reading_structure(measurement, series, theta)
        laws = Laws.stated(structure) if laws is None else laws
        setups = measurement.setup_of_readings(series)
        instruments = [measurement.setups[s].instrument.name for s in setups]
        standard = structure.standardise(measurement.jacobian(series, theta))
        index, machine = np.arange(len(theta)), len(measurement.machine.parameters)
        effect = index >= len(theta) - coefficients
        return cls(
            structure=structure,
            slopes=measurement.in_prior_units(standard),
            readings=errors_of_readings(structure, laws, instruments),
            root=measurement.prior_root(),
            names=tuple(measurement.names),
            instruments=tuple(dict.fromkeys(instruments)),
            used=np.flatnonzero((index < machine) | effect),
            setup=(index >= machine) & ~effect & measurement.free,
            effect=effect & measurement.free,
        )


def _posterior(information: Array, removed: Mask | None) -> Array:
    """(I + M)^-1 (n, n); rows and columns of known parameters are 0."""
    covariance = np.zeros_like(information)
    count = len(information)
    free = np.arange(count) if removed is None else np.flatnonzero(~removed)
    block = information[np.ix_(free, free)] + np.eye(len(free))
    covariance[np.ix_(free, free)] = np.linalg.inv(block)
    return covariance


# -- lines -------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """A source of the errors that remain, for k pose components, SI."""

    source: str  #: its name
    kind: LineKind  #: what sort of source it is
    #: (k,) mean over the workspace; below 0 where the linear calculation predicts too
    #: much
    variance: Array
    #: (k,) rms error of the whole without it; None where nobody can remove it
    without: Array | None = None
    #: (k,) rms error of the whole with half its standard deviation, or None
    halved: Array | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Budget:
    """Sources of the errors of the compensated machine."""

    names: tuple[str, ...]  #: (k,) of the pose components
    #: (k,) predicted, SI, mean over the workspace; the lines add up to it
    variance: Array
    lines: tuple[Line, ...]  #: of what the prediction contains

    def shares(self) -> Mapping[str, dict[str, float]]:
        """Share of the variance by component and source."""
        table: dict[str, dict[str, float]] = {}
        for k, name in enumerate(self.names):
            total = self.variance[k]
            table[name] = {
                line.source: float(line.variance[k] / total) if total > 0.0 else 0.0
                for line in self.lines
            }
        return table


def mean_products(maps: Array) -> Array:
    """Products (k, p, p) of the rows of maps (n, k, p), their mean over n poses."""
    by_component = maps.transpose(1, 2, 0)
    return by_component @ by_component.transpose(0, 2, 1) / len(maps)


def mean_variance(products: Array, covariance: Array) -> Array:
    """Mean variances (k,) of maps @ N(0, covariance) by the maps' `mean_products`."""
    return np.asarray((products * covariance).sum(axis=(1, 2)))


def _add_remainder(lines: Sequence[Line], variance: Array) -> tuple[Line, ...]:
    """The lines with what linearisation leaves out in `without` and `halved`."""
    linear = np.sum([li.variance for li in lines if li.without is not None], axis=0)
    beyond = variance - linear

    def whole(rms: Array | None) -> Array | None:
        if rms is None:
            return None
        return np.asarray(np.sqrt(np.maximum(rms**2 + beyond, 0.0)))

    def plain(part: Array) -> Array:
        return np.where(np.abs(part) > SHARE_TOLERANCE * variance, part, 0.0)

    return tuple(
        dataclasses.replace(
            li,
            variance=plain(li.variance),
            without=whole(li.without),
            halved=whole(li.halved),
        )
        for li in lines
    )


def _line(model: BudgetModel, products: Array, part: CovariancePart) -> Line:
    """A line with the rms errors of the linear model without it and with half."""
    variance = mean_variance(products, part.covariance)

    def rms(covariance: Array) -> Array:
        # the difference of two large covariances may be negative by its rounding
        return np.sqrt(np.maximum(mean_variance(products, covariance), 0.0))

    changed = _alternatives(model, part)
    without, halved = (None if change is None else rms(change()) for change in changed)
    return Line(part.source, part.kind, variance, without, halved)


def _alternatives(
    model: BudgetModel, part: CovariancePart
) -> tuple[Callable[[], Array], Callable[[], Array] | None]:
    """Covariances without a source, and with half its standard deviation."""
    source = part.source
    if part.kind in ("instrument", "run", "course", "noise law"):
        return (
            lambda: model.covariance({source: REMOVAL_FACTOR}),
            lambda: model.covariance({source: 0.5}),
        )
    masks = {SETUP: model.setup, EFFECTS: model.effect}
    if source in masks:
        return lambda: model.covariance(removed=masks[source]), None
    whole = model.covariance()
    return lambda: whole - part.covariance, lambda: model.covariance(prior=0.5)


# -- what linearisation leaves out -----------------------------------------------------
def variance_over_machines(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    references: Sequence[Reference],
    rng: np.random.Generator,
    tool: Array = NO_TOOL,
) -> dict[Reference, Array]:
    """Variances (n, k), SI, at commands (n, n_dof) of what calibration leaves.

    They are means over machines drawn from the tolerances, by reference; none where
    hardly one of them can be assembled.
    """
    truths = draw_parameters(measurement, rng, N_MACHINES)
    groups = -(-len(truths) * len(command) // MAX_POSES)
    sums: dict[Reference, Array] = {}
    assembled = 0
    for group in np.array_split(truths, groups):
        maps = _assembled_maps(measurement, command, references, tool, group)
        for truth, by_reference in maps:
            try:
                covariance = BudgetModel.of(measurement, series, truth).covariance()
            except AssemblyError:
                continue
            assembled += 1
            for reference, raw in by_reference.items():
                variance = np.einsum("nkp,nkp->nk", raw @ covariance, raw)
                sums[reference] = sums.get(reference, 0.0) + variance
    if assembled < N_MACHINES // 2:
        return {}
    return {reference: total / assembled for reference, total in sums.items()}


def _assembled_maps(
    measurement: Measurement,
    command: Array,
    references: Sequence[Reference],
    tool: Array,
    truths: Array,
) -> list[tuple[Array, dict[Reference, Array]]]:
    """Of those machines with parameters (m, n) that assemble: the parameters, and maps."""
    count = len(measurement.machine.parameters)
    kinematics = measurement.kinematics
    while len(truths):
        try:
            maps = raw_maps_of_machines(
                kinematics, command, references, tool, truths[:, :count]
            )
        except AssemblyError as error:
            lost = np.unique(error.indices // (len(command) + 1))
            truths = np.delete(truths, lost, axis=0)
        else:
            return list(zip(truths, maps, strict=True))
    return []
