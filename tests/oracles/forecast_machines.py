"""Oracle for machines whose legs yield and whose scales are bent, of five kinds.

Each leg is a spring: it gives by the load that virtual work puts on it, F = W dz/dq. Its
scale has a bow and a wave, and the geometry is off by what a calibration leaves. The
poses come from the closed forms of the other oracles. It must never import the toolkit.
SI units (m, rad, N).
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oracles import (
    a3_geometry,
    delta_trilateration,
    hexapod_geometry,
    planar_geometry,
    prs_geometry,
)

#: sizes of what is drawn: sag of a leg under its share, bow, wave, parameters, m
SAG, BOW, WAVE, LEFT = 40e-6, 20e-6, 8e-6, 10e-6
#: step of the virtual work, m
STEP = 1e-5
LEVEL = np.eye(3)

#: points (n, 3) and rotations (n, 3, 3)
Frames = tuple[NDArray, NDArray]


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


def _turn(frames: Frames, wanted: Frames) -> NDArray:
    return Rotation.from_matrix(frames[1] @ np.swapaxes(wanted[1], 1, 2)).as_rotvec()


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


def _a3_errors(command: NDArray, frames: Frames, wanted: Frames) -> NDArray:
    psi, theta, _ = a3_geometry.euler(frames[1])
    turn = np.mod(psi - command[:, 1] + np.pi, 2.0 * np.pi) - np.pi
    height = frames[0][:, 2] - wanted[0][:, 2]
    return np.column_stack([height, turn, theta - command[:, 2]])


A3 = Kind(
    joints=lambda c: a3_geometry.inverse_nominal(*c.T),
    wanted=lambda c: a3_geometry.nominal_pose(*c.T),
    frames=lambda q, p: a3_geometry.forward(p, q)[:2],
    errors=_a3_errors,
    low=np.array([1.066, 0.0, np.radians(8.0)]),
    high=np.array([1.266, 2.0 * np.pi, np.radians(35.0)]),
    home=np.array([1.066, 0.0, 0.0]),
    parameters=24,
)


def _prs_errors(command: NDArray, frames: Frames, wanted: Frames) -> NDArray:
    angles = prs_geometry.angles(frames[1])[:, :2] - command[:, 1:]
    return np.column_stack([frames[0][:, 2] - wanted[0][:, 2], angles])


PRS = Kind(
    joints=lambda c: prs_geometry.nominal(*c.T)[2],
    wanted=lambda c: prs_geometry.nominal(*c.T)[:2],
    frames=lambda q, p: prs_geometry.forward(q, p.reshape(3, 6))[:2],
    errors=_prs_errors,
    low=np.array([0.1, -0.4, -0.4]),
    high=np.array([0.3, 0.4, 0.4]),
    home=np.array([0.2, 0.0, 0.0]),
    parameters=18,
)


RADIUS, ARM = 0.16175, 0.345
TOWERS = np.radians([210.0, 330.0, 90.0])
ENDSTOPS = 0.420


def _nozzle(q: NDArray, p: NDArray) -> Frames:
    arms, endstops = ARM + p[3:], ENDSTOPS + p[:3]
    return _level(delta_trilateration.nozzle(q, RADIUS, arms, TOWERS, endstops))


DELTA = Kind(
    joints=lambda c: delta_trilateration.travel_to(c, RADIUS, ARM, TOWERS, ENDSTOPS),
    wanted=_level,
    frames=_nozzle,
    errors=_moved,
    low=np.array([-0.08, -0.08, 0.02]),
    high=np.array([0.08, 0.08, 0.2]),
    home=np.array([0.0, 0.0, 0.02]),
    parameters=6,
)


def hexapod(base: NDArray, local: NDArray) -> Kind:
    """A hexapod with joints base and local (6, 3); its parameters are those of the base."""

    def wanted(command: NDArray) -> Frames:
        tilt = np.column_stack([command[:, 3:5], np.zeros(len(command))])
        spin = Rotation.from_rotvec(command[:, 5:] * LEVEL[2])
        turned = Rotation.from_rotvec(tilt) * spin
        return command[:, :3], turned.as_matrix()

    def joints(command: NDArray) -> NDArray:
        poses = zip(*wanted(command), strict=True)
        return np.array([hexapod_geometry.legs(*pose, base, local) for pose in poses])

    home = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    start = home[:3] + local

    def frames(q: NDArray, p: NDArray) -> Frames:
        moved = base + p.reshape(6, 3)
        poses = [hexapod_geometry.forward(row, moved, local, start) for row in q]
        points, rotations = zip(*poses, strict=True)
        return np.array(points), np.array(rotations)

    return Kind(
        joints=joints,
        wanted=wanted,
        frames=frames,
        errors=lambda c, f, w: np.hstack([_moved(c, f, w), _turn(f, w)]),
        low=np.array([-0.1, -0.1, 0.45, -0.15, -0.15, 0.0]),
        high=np.array([0.1, 0.1, 0.55, 0.15, 0.15, 0.0]),
        home=home,
        parameters=18,
    )
