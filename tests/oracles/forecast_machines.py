"""Oracle for a machine whose legs yield and whose scales are bent.

Each leg is a spring: it gives by the load that virtual work puts on it, F = W dz/dq. Its
scale has a bow and a wave, and the geometry is off by what a calibration leaves. The
poses come from the closed form of another oracle. It must never import the toolkit.
SI units (m, rad, N).
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from oracles import planar_geometry

#: sizes of what is drawn: sag of a leg under its share, bow, wave, parameters, m
SAG, BOW, WAVE, LEFT = 40e-6, 20e-6, 8e-6, 10e-6
STEP = 1e-5  #: step of the virtual work, m
LEVEL = np.eye(3)

Frames = tuple[NDArray, NDArray]  #: points (n, 3) and rotations (n, 3, 3)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of machine.

    joints(command)  (n, q) of the controller
    wanted(command)  frames that the commands mean
    frames(q, p)     frames at joints, of a machine with parameter errors p
    errors(c, f, w)  (n, k) errors of frames against the wanted ones
    low, high        workspace of the commands; home
    parameters       number of parameter errors
    """

    joints: Callable[[NDArray], NDArray]
    wanted: Callable[[NDArray], Frames]
    frames: Callable[[NDArray, NDArray], Frames]
    errors: Callable[[NDArray, Frames, Frames], NDArray]
    low: NDArray
    high: NDArray
    home: NDArray
    parameters: int


@dataclasses.dataclass(frozen=True)
class Yielding:
    """One machine.

    factors        (4, q) of sag, bow and wave of each leg, and the wave's phase
    p              parameter errors
    middle, reach  (q,) of the joints over the workspace, m
    """

    kind: Kind
    factors: NDArray
    p: NDArray
    middle: NDArray
    reach: NDArray

    def errors(self, command: NDArray, added: NDArray | float = 0.0) -> NDArray:
        """Errors (n, k) against home, with `added` (n, q) on the joints, none at home."""
        both = np.vstack([command, self.kind.home])
        q = self.kind.joints(both)
        q[:-1] += added
        point, rotation = self._frames(q)
        wanted, straight = self.kind.wanted(both)
        turned = np.swapaxes(straight, 1, 2) @ rotation  # on the platform's axes
        zeroed = straight @ turned @ turned[-1].T
        moved = point - (point[-1] - wanted[-1])
        frames, goal = (moved[:-1], zeroed[:-1]), (wanted[:-1], straight[:-1])
        return self.kind.errors(command, frames, goal)

    def _frames(self, q: NDArray) -> Frames:
        """Where the legs come to rest."""
        load = self._height_slope(q)
        usual = np.abs(self._height_slope(self.middle[None])).mean()
        place = (q - self.middle) / self.reach
        sag, bow, wave, phase = self.factors
        change = -SAG * sag * load / usual + BOW * bow * place**2
        change += WAVE * wave * np.sin(3.0 * place + phase)
        return self.kind.frames(q + change, self.p)

    def _height_slope(self, q: NDArray) -> NDArray:
        slopes = np.empty_like(q)
        for k in range(q.shape[1]):
            step = STEP * (np.arange(q.shape[1]) == k)
            above = self.kind.frames(q + step, self.p)[0][:, 2]
            below = self.kind.frames(q - step, self.p)[0][:, 2]
            slopes[:, k] = (above - below) / (2.0 * STEP)
        return slopes


def draw(kind: Kind, rng: np.random.Generator) -> Yielding:
    """A machine after calibration."""
    places = kind.joints(rng.uniform(kind.low, kind.high, (200, len(kind.low))))
    joints = places.shape[1]
    factors = np.vstack(
        [
            np.exp(0.3 * rng.standard_normal(joints)),
            rng.standard_normal((2, joints)),
            rng.uniform(0.0, 2.0 * np.pi, joints),
        ]
    )
    p = LEFT * rng.standard_normal(kind.parameters)
    low, high = places.min(axis=0), places.max(axis=0)
    return Yielding(kind, factors, p, (low + high) / 2.0, (high - low) / 2.0)


def _level(points: NDArray) -> Frames:
    return points, np.broadcast_to(LEVEL, (len(points), 3, 3))


def _moved(command: NDArray, frames: Frames, wanted: Frames) -> NDArray:
    return frames[0] - wanted[0]


def _in_yz(points: NDArray) -> Frames:
    return _level(np.column_stack([np.zeros(len(points)), points]))


PLANAR = Kind(
    joints=planar_geometry.inverse,
    wanted=_in_yz,
    frames=lambda q, p: _in_yz(planar_geometry.forward(q, planar_geometry.NOMINAL + p)),
    errors=lambda c, f, w: _moved(c, f, w)[:, 1:],
    low=np.array([-1.5, 0.0]),
    high=np.array([1.5, 1.5]),
    home=np.zeros(2),
    parameters=7,
)
