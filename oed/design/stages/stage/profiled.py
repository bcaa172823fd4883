"""Information about the machine alone: all other unknowns of a stage profiled out.

With the information M over machine parameters m and other unknowns o, each of which is
N(0, 1) before, the readings add

    M_mm - M_mo (1 + M_oo)^-1 M_om = M_mm - K M_om

about the machine. K u is what known unknowns u change in its normal equations.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array


@dataclasses.dataclass(frozen=True, eq=False)
class ProfiledInformation:
    """Information of each pattern (G) of captured candidates.

    machine   (G, n, n) about the machine's parameters
    by_setup  (G, n, s) columns of K for the set-ups' unknowns
    """

    machine: Array
    by_setup: Array

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
