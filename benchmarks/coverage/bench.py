"""A machine with its readings, as the toolkit plans them and as an oracle reads them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.coverage.noise import Layout
from oed.estimation import IdentifiableCoordinates
from oed.measurement import Measurement, Series
from oed.noise import NoiseStatement


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Bench:
    """One configuration.

    name         of the machines and errors that are drawn
    about        for the table
    measurement  the toolkit's
    series       its planned readings, N in all
    stages       of the identification
    command      (n, n_dof) workspace poses, SI
    read         exact readings (N,) of the oracle's machine theta (n,), SI
    errors       pose errors (n, k) of the oracle's machine, driven with believed
                 parameters (np,), zeroed at home; SI
    """

    name: str
    about: str
    measurement: Measurement
    series: Sequence[Series]
    stages: Sequence[Sequence[str]] = (("*",),)
    command: np.ndarray
    read: Callable[[np.ndarray], np.ndarray]
    errors: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def stating(self, statement: NoiseStatement, about: str) -> Bench:
        """The same machines with the same errors, of which the study states something."""
        mounted = self.measurement.setups.values()
        setups = [dataclasses.replace(s, statement=statement) for s in mounted]
        return dataclasses.replace(
            self,
            about=f"{self.about}; {about}",
            measurement=self.measurement.with_setups(setups),
        )

    @functools.cached_property
    def coordinates(self) -> IdentifiableCoordinates:
        """Identifiable combinations: those of the readings at nominal parameters."""
        m = self.measurement
        noise = m.noise(self.series)
        return IdentifiableCoordinates.of(m, self.series, m.nominal, noise)

    @functools.cached_property
    def layout(self) -> Layout:
        """Chains and stated noise of the readings."""
        chain, sigma, shared = [], [], []
        for s in self.series:
            setup = self.measurement.setups[s.setup]
            channels = setup.instrument.channels
            labels = {label: k for k, label in enumerate(dict.fromkeys(s.run))}
            run = np.repeat([labels[label] for label in s.run], len(channels))
            channel = np.tile(np.arange(len(channels)), len(s))
            begin = 0 if not chain else chain[-1].max() + 1
            chain.append(begin + run * len(channels) + channel)
            sigma.append(np.tile(setup.sigma, len(s)))
            common = np.array([c.shared for c in channels]) * setup.sigma
            shared.append(np.tile(common, len(s)))
        return Layout(*(np.concatenate(v) for v in (chain, sigma, shared)))


def components_from_home(
    m: Measurement, command: np.ndarray, rotation: np.ndarray, point: np.ndarray
) -> np.ndarray:
    """Pose error components (n, k) of a machine that was zeroed at home.

    rotation  (n + 1, 3, 3) of the oracle's machine, at the commands and at home
    point     (n + 1, 3)
    """
    poses = np.vstack([command, m.machine.home_command])
    x, _ = m.kinematics.inverse(poses)
    wanted, tip, _ = m.kinematics.frames(x, np.zeros(3))
    place = point - tip
    zeroed = rotation[:-1] @ rotation[-1].T @ wanted[-1]
    turn = Rotation.from_matrix(zeroed @ np.swapaxes(wanted[:-1], 1, 2)).as_rotvec()
    twist = np.hstack([place[:-1] - place[-1], turn])
    return m.kinematics.error_components(command, twist)
