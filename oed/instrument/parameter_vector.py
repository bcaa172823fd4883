"""The parameter vector theta of a machine with its set-ups: names, priors, lengths.

theta = [machine parameters, unknowns of set-up 1, of set-up 2, ...].
"""

import dataclasses
import fnmatch
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.instrument.instrument import Setup
from oed.linear_algebra import symmetric_root
from oed.model import Machine, Parameter


class ParameterVector:
    """Parameters (n,) of a machine and of the set-ups that read it.

    machine     the machine
    parameters  of theta; those of a set-up are named `set-up.parameter`, and those that
                set-ups share `station.parameter`

    Raises ValueError for set-up names that repeat, and unlike unknowns of a station.
    """

    def __init__(self, machine: Machine, setups: Sequence[Setup]) -> None:
        names = [setup.name for setup in setups]
        if len(set(names)) != len(names):
            raise ValueError(f"set-up names are not unique: {names}")
        self.machine = machine
        parameters = list(machine.parameters)
        self._nuisances: dict[str, slice] = {}
        stations: dict[str, Setup] = {}
        for setup in setups:
            first = stations.setdefault(setup.owner, setup)
            if first.nuisances != setup.nuisances:
                raise ValueError(
                    f"{first.name} and {setup.name} share a station, and not its unknowns"
                )
            start = len(parameters)
            for nuisance in setup.nuisances if first is setup else ():
                name = f"{setup.owner}.{nuisance.name}"
                parameters.append(dataclasses.replace(nuisance, name=name))
            rows = slice(start, len(parameters))
            self._nuisances[setup.name] = self._nuisances.get(first.name, rows)
        self.parameters: tuple[Parameter, ...] = tuple(parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names (n,) of theta's entries."""
        return tuple(p.name for p in self.parameters)

    @property
    def nominal(self) -> Array:
        """Prior mean (n,) of theta, SI: nominal but for what an earlier session knows."""
        return np.array([p.mean for p in self.parameters])

    @property
    def drawn(self) -> Array:
        """Theta (n,) of the drawing, SI."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def tolerance(self) -> Array:
        """Prior standard deviations (n,), SI; 0 for those that only choose the frame."""
        frame = self.machine.frame
        return np.array(
            [0.0 if p.name in frame else p.tolerance for p in self.parameters]
        )

    @property
    def free(self) -> Mask:
        """Mask (n,) of the entries of theta that are unknown."""
        return self.tolerance > 0.0

    @property
    def free_names(self) -> list[str]:
        """Names of the entries of theta that are unknown, in their order."""
        return [self.names[k] for k in np.flatnonzero(self.free)]

    @property
    def bounds(self) -> Array:
        """Least and largest values (n, 2) that theta's entries can have, SI."""
        return np.array([p.bounds for p in self.parameters])

    @property
    def bounded(self) -> Index:
        """Free entries, by number, that have a bound."""
        return np.flatnonzero(np.isfinite(self.bounds).any(axis=1) & self.free)

    def in_bounds(self, theta: Array, entries: Index | None = None) -> Mask:
        """Which vectors theta (..., n) keep to the bounds of all, or some, entries."""
        members = self.bounded if entries is None else entries
        lower, upper = self.bounds[members].T
        values = theta[..., members]
        return np.asarray(((values >= lower) & (values <= upper)).all(axis=-1))

    @property
    def correlation(self) -> Array | None:
        """Prior correlation (n, n), the last of a pair; None if independent."""
        if not self.machine.correlated:
            return None
        rows = {name: k for k, name in enumerate(self.names)}
        matrix = np.eye(len(rows))
        for group in self.machine.correlated:
            members = [rows[name] for name in group.names]
            matrix[np.ix_(members, members)] = group.correlation
        np.fill_diagonal(matrix, 1.0)
        return matrix

    def correlation_root(self, members: Index) -> Array:
        """Symmetric root S (k, k) of the prior correlation of some entries (k,).

        The entries deviate from nominal by tolerance * S z, with z ~ N(0, I) a priori.
        """
        correlation = self.correlation
        if correlation is None:
            return np.eye(len(members))
        block = correlation[np.ix_(members, members)]
        return np.asarray(symmetric_root(block[None])[0])

    def prior_root(self, freed: Mask | None = None) -> Array:
        """Root R (n, n), SI, of the prior covariance: theta = nominal + R z.

        freed  (n,) entries that are not held, all unknown ones by default; rows and
               columns of the others are 0
        """
        members = np.flatnonzero(self.free if freed is None else freed)
        root = np.zeros((len(self.parameters), len(self.parameters)))
        shape = self.correlation_root(members)
        root[np.ix_(members, members)] = self.tolerance[members, None] * shape
        return root

    @property
    def prior_covariance(self) -> Array:
        """Prior covariance (n, n) of theta, SI."""
        root = self.prior_root()
        return root @ root.T

    def in_prior_units(self, rows: Array, freed: Mask | None = None) -> Array:
        """Slopes (..., n) over theta as slopes over z (see `prior_root`)."""
        if self.correlation is not None:
            return rows @ self.prior_root(freed)
        scale = self.tolerance
        return rows * (scale if freed is None else np.where(freed, scale, 0.0))

    def from_prior_units(self, covariance: Array, freed: Mask | None = None) -> Array:
        """Covariance (n, n) of z (see `prior_root`) as that of theta, SI."""
        if self.correlation is not None:
            root = self.prior_root(freed)
            return root @ covariance @ root.T
        scale = self.tolerance
        scale = scale if freed is None else np.where(freed, scale, 0.0)
        return covariance * np.outer(scale, scale)

    def freed(self, patterns: Sequence[str]) -> Mask:
        """Mask (n,) of the unknown entries whose name fits a pattern, as in "dq*"."""
        fits = [any(fnmatch.fnmatchcase(n, p) for p in patterns) for n in self.names]
        return np.asarray(self.free & np.array(fits))

    @property
    def length_factors(self) -> Array:
        """Factor (n,) that makes each entry a length, m: else the lever."""
        lever = self.machine.lever
        return np.array([1.0 if p.unit == "m" else lever for p in self.parameters])

    def nuisance_slice(self, setup: str) -> slice:
        """Where the unknowns of a set-up are in theta."""
        return self._nuisances[setup]
