"""The parameter vector theta of a machine with its set-ups: names, priors, lengths.

theta = [machine parameters, unknowns of set-up 1, of set-up 2, ...].
"""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Mask
from oed.instrument import Setup
from oed.machine import Machine, Parameter


class ParameterVector:
    """Parameters (n,) of a machine and of the set-ups that read it.

    machine     the machine
    parameters  of theta; those of a set-up are named `set-up.parameter`

    Raises ValueError for set-up names that repeat.
    """

    def __init__(self, machine: Machine, setups: Sequence[Setup]) -> None:
        names = [setup.name for setup in setups]
        if len(set(names)) != len(names):
            raise ValueError(f"set-up names are not unique: {names}")
        self.machine = machine
        parameters = list(machine.parameters)
        self._nuisances: dict[str, slice] = {}
        for setup in setups:
            start = len(parameters)
            for nuisance in setup.nuisances:
                name = f"{setup.name}.{nuisance.name}"
                parameters.append(dataclasses.replace(nuisance, name=name))
            self._nuisances[setup.name] = slice(start, len(parameters))
        self.parameters: tuple[Parameter, ...] = tuple(parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names (n,) of theta's entries."""
        return tuple(p.name for p in self.parameters)

    @property
    def nominal(self) -> Array:
        """Nominal theta (n,), SI."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def tolerance(self) -> Array:
        """Prior standard deviations (n,), SI; 0 for those that only choose the frame."""
        held = self.machine.frame
        return np.array(
            [0.0 if p.name in held else p.tolerance for p in self.parameters]
        )

    @property
    def free(self) -> Mask:
        """Mask (n,) of the entries of theta that are unknown."""
        return np.asarray(self.tolerance > 0.0)

    def freed(self, patterns: Sequence[str]) -> Mask:
        """Mask (n,) of the unknown entries whose name fits a pattern, as in "dq*"."""
        fits = [any(fnmatch.fnmatchcase(n, p) for p in patterns) for n in self.names]
        return np.asarray(self.free & np.array(fits))

    @property
    def length_factors(self) -> Array:
        """Factor (n,) that turns each entry into a length, m.

        It is the machine's lever for angles and ratios.
        """
        lever = self.machine.lever
        return np.array([1.0 if p.unit == "m" else lever for p in self.parameters])

    def nuisance_slice(self, setup: str) -> slice:
        """Where the unknowns of a set-up are in theta."""
        return self._nuisances[setup]
