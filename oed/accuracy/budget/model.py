"""Covariance of identified parameters as a sum over its sources, and without some.

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

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from oed.accuracy.budget.reading_errors import (
    BEYOND,
    COURSE,
    ReadingErrors,
    errors_of_readings,
    instrument_source,
)
from oed.base import Array, Index, Mask
from oed.measurement import Measurement, Series, reading_structure
from oed.noise import Laws, ReadingStructure

Kind = Literal["instrument", "run", "course", "noise law", "set-up", "effects", "prior"]
#: errors that are taken away in turn
TAKEN_AWAY: tuple[Kind, ...] = ("run", "course", "noise law")
SETUP = "unknown set-up"
EFFECTS = "sizes of the effects"
UNDETERMINED = "combinations that no reading determines"
TOLERANCES = "pull of the tolerances"


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A part of the covariance (k, k), SI, of the parameters that move the pose."""

    source: str
    kind: Kind
    covariance: Array


@dataclasses.dataclass(frozen=True, eq=False)
class BudgetModel:
    """Readings of n parameters, linear, with normal errors.

    structure    of the readings
    slopes       (N, n) in units of stated noise, over z ~ N(0, I) a priori
    readings     errors of the readings
    root         (n, n) of the prior covariance, SI: parameters deviate by root z
    names        (n,) of the parameters
    instruments  of the readings, each once
    used         (k,) the parameters that move the pose
    setup        (n,) which are unknowns of the set-ups
    effect       (n,) which are coefficients of effects
    """

    structure: ReadingStructure
    slopes: Array
    readings: ReadingErrors
    root: Array
    names: tuple[str, ...]
    instruments: tuple[str, ...]
    used: Index
    setup: Mask
    effect: Mask

    @property
    def errors(self) -> dict[str, Kind]:
        """The readings' errors, and of which kind each is."""
        stated = {instrument_source(name) for name in self.instruments}
        kinds: dict[str, Kind] = {}
        for name in self.readings.names:
            kinds[name] = "run"
            if name in stated:
                kinds[name] = "instrument"
            if name == COURSE:
                kinds[name] = "course"
            if name == BEYOND:
                kinds[name] = "noise law"
        return kinds

    def information(self, factors: Mapping[str, float] | None = None) -> Array:
        """H^T C^-1 H (n, n), with factors on the standard deviations of errors."""
        white = self.readings.whiten(self.slopes, factors or {})
        return white.T @ white

    def covariance(
        self,
        factors: Mapping[str, float] | None = None,
        known: Mask | None = None,
        prior: float = 1.0,
    ) -> Array:
        """Covariance (k, k), SI, of the used parameters.

        factors  on the standard deviations of the readings' errors, by name
        known    (n,) parameters that are known
        prior    factor on the tolerances of the machine's parameters
        """
        scale = np.where(self.setup | self.effect, 1.0, prior)
        information = self.information(factors) * np.outer(scale, scale)
        covariance = _posterior(information, known)
        return self._in_si(covariance * np.outer(scale, scale))

    def response(self, changes: Array) -> Array:
        """Change (k, m), SI, of the estimate by changes (N, m) of the readings, SI."""
        standard = self.structure.standardise(changes)
        score = self.slopes.T @ self.readings.weigh(standard, {})
        change = _posterior(self.information(), None) @ score
        return (self.root @ change)[self.used]

    def parts(self) -> list[Part]:
        """Parts that add up to `covariance()`; those that are nothing are absent."""
        information = self.information()
        whole = _posterior(information, None)
        parts: list[Part] = []
        known = np.zeros(len(self.names), dtype=bool)
        gone: dict[str, float] = {}
        for source, kind, members in self._steps():
            if members is None:
                gone[source] = 0.0
                information = self.information(gone)
            else:
                known = known | members
            rest = _posterior(information, known)
            parts.append(Part(source, kind, self._in_si(whole - rest)))
            whole = rest
        parts += self._instrument_parts(whole, gone)
        return parts + self._prior_parts(information, known)

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
    ) -> list[Part]:
        """The stated noises through the estimate with this covariance (n, n)."""
        names = [n for n, kind in self.errors.items() if kind == "instrument"]
        weighed = self.readings.weigh(self.slopes, gone) @ covariance
        totals = [self.readings.between(name, weighed) for name in names]
        return [
            Part(name, "instrument", self._in_si(total))
            for name, total in zip(names, totals, strict=True)
        ]

    def _prior_parts(self, information: Array, known: Mask) -> list[Part]:
        """The tolerances: what no reading determines, and their pull on the others."""
        free = np.flatnonzero(~known)
        gain, vectors = np.linalg.eigh(information[np.ix_(free, free)])
        weight = 1.0 / (1.0 + np.maximum(gain, 0.0)) ** 2
        parts = []
        for source, members in ((UNDETERMINED, gain < 1.0), (TOLERANCES, gain >= 1.0)):
            if members.any():
                part = np.zeros_like(information)
                chosen = vectors[:, members]
                inner = (chosen * weight[members]) @ chosen.T
                part[np.ix_(free, free)] = inner
                parts.append(Part(source, "prior", self._in_si(part)))
        return parts

    def _in_si(self, covariance: Array) -> Array:
        """The used parameters' block (k, k), SI, of a covariance (n, n) of z."""
        rows = self.root[self.used]
        return rows @ covariance @ rows.T


def _posterior(information: Array, known: Mask | None) -> Array:
    """(I + M)^-1 (n, n); rows and columns of known parameters are 0."""
    covariance = np.zeros_like(information)
    count = len(information)
    free = np.arange(count) if known is None else np.flatnonzero(~known)
    block = information[np.ix_(free, free)] + np.eye(len(free))
    covariance[np.ix_(free, free)] = np.linalg.inv(block)
    return covariance


def budget_model(
    measurement: Measurement,
    series: Sequence[Series],
    theta: Array,
    *,
    laws: Laws | None = None,
    coefficients: int = 0,
) -> BudgetModel:
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
    return BudgetModel(
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
