"""How named angles make an orientation: stated once for tables, importers and checks.

A product of rotations from left to right, each about an axis of a right-handed frame, or
by a tilt (rx, ry, 0) as a rotation vector:

    R = Rx(alpha) Ry(beta) Rz(gamma)          R = T(rx, ry) Rz(spin)

R takes vectors of the platform's frame into the frame of the angles. Where angles give
the direction of the tool axis alone, it is n = R e_z.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
import scipy  # its parts load when first used: light commands need names alone

from oed.base.arrays import Array

AXES = "xyz"
TILT = "tilt"  #: a rotation by the vector (rx, ry, 0)
MIN_TILT_SINE = 1e-12  #: sine of an angle below which its direction is left at 0

#: rotation about an axis, or a tilt, with the names of its angles
Factor = tuple[str, tuple[str, ...]]


@dataclasses.dataclass(frozen=True, slots=True)
class Orientation:
    """What angles mean."""

    factors: tuple[Factor, ...]  #: rotations from left to right
    axis_only: bool = False  #: whether the angles give n = R e_z alone

    @classmethod
    def rotation(cls, *factors: tuple[str, str]) -> "Orientation":
        """Rotations about axes, as in `rotation(("x", "alpha"), ("y", "beta"))`."""
        return cls(tuple((axis, (name,)) for axis, name in factors))

    @classmethod
    def direction(cls, *factors: tuple[str, str]) -> "Orientation":
        """As `rotation`, of which the direction n = R e_z alone is meant."""
        return cls(cls.rotation(*factors).factors, axis_only=True)

    @classmethod
    def tilt(cls, rx: str, ry: str) -> "Orientation":
        """The direction n = T(rx, ry) e_z of a tilt by the rotation vector (rx, ry, 0)."""
        return cls(((TILT, (rx, ry)),), axis_only=True)

    @classmethod
    def tilt_and_spin(cls, rx: str, ry: str, spin: str) -> "Orientation":
        """A spin about z, then a tilt by the rotation vector (rx, ry, 0)."""
        return cls(((TILT, (rx, ry)), ("z", (spin,))))

    @staticmethod
    def along(axes: Array) -> Array:
        """One of the rotations (n, 3, 3) whose third axis is along vectors (n, 3)."""
        unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        turns = scipy.spatial.transform.Rotation.from_rotvec(_tilt_vectors(unit))
        return np.asarray(turns.as_matrix())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the angles, in the order of the factors."""
        return tuple(name for _, names in self.factors for name in names)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the angles that decide the tool axis: all but a last turn about z."""
        return self.names[:-1] if self.factors[-1][0] == "z" else self.names

    @property
    def formula(self) -> str:
        """The product in words: `R = Rx(alpha) Ry(beta) Rz(gamma)`."""
        symbols = {TILT: "T"} | {axis: f"R{axis}" for axis in AXES}
        product = " ".join(
            f"{symbols[kind]}({', '.join(names)})" for kind, names in self.factors
        )
        return f"n = {product} e_z" if self.axis_only else f"R = {product}"

    def matrices(self, angles: Mapping[str, Array]) -> Array:
        """R (n, 3, 3) from angles (n,) by name, rad; one that has the axis."""
        count = len(np.atleast_1d(angles[self.names[0]]))
        whole = scipy.spatial.transform.Rotation.identity(count)
        for kind, names in self.factors:
            vectors = np.zeros((count, 3))
            entries = (0, 1) if kind == TILT else (AXES.index(kind),)
            for axis, name in zip(entries, names, strict=True):
                vectors[:, axis] = angles[name]
            whole = whole * scipy.spatial.transform.Rotation.from_rotvec(vectors)
        return np.asarray(whole.as_matrix())

    def angles(self, matrices: Array) -> dict[str, Array]:
        """Angles (n,) by name, rad, of R (n, 3, 3). Raises ValueError."""
        kinds = "".join(kind if kind in AXES else "t" for kind, _ in self.factors)
        if kinds in ("tz", "t"):
            values = _tilt_and_spin(matrices)
        elif kinds == "zx":
            values = _precession_and_nutation(matrices)
        elif kinds == "xy":
            values = list(_euler(matrices, "XYZ")[:2])
        elif len(kinds) == 3 and len(set(kinds)) == 3 and "t" not in kinds:
            values = list(_euler(matrices, kinds.upper()))
        else:
            raise ValueError(f"{self.formula} has no inverse here")
        return dict(zip(self.names, values, strict=False))


def _euler(matrices: Array, axes: str) -> Array:
    """Angles (3, n) about moving axes, in the order of the product."""
    return np.asarray(
        scipy.spatial.transform.Rotation.from_matrix(matrices).as_euler(axes).T
    )


def _tilt_vectors(axes: Array) -> Array:
    """Rotation vectors (n, 3) in the plane z = 0 that take e_z to unit vectors (n, 3)."""
    sine = np.hypot(axes[:, 0], axes[:, 1])
    angle = np.arctan2(sine, axes[:, 2])
    scale = np.where(sine > MIN_TILT_SINE, angle / np.maximum(sine, MIN_TILT_SINE), 1.0)
    return np.column_stack([-axes[:, 1] * scale, axes[:, 0] * scale, 0.0 * sine])


def _tilt_and_spin(matrices: Array) -> list[Array]:
    vectors = _tilt_vectors(matrices[:, :, 2])
    untilted = scipy.spatial.transform.Rotation.from_rotvec(
        -vectors
    ) * scipy.spatial.transform.Rotation.from_matrix(matrices)
    first = untilted.as_matrix()
    spin = np.arctan2(first[:, 1, 0], first[:, 0, 0])
    return [vectors[:, 0], vectors[:, 1], spin]


def _precession_and_nutation(matrices: Array) -> list[Array]:
    """psi and theta of n = Rz(psi) Rx(theta) e_z, theta >= 0."""
    x, y, z = np.moveaxis(matrices[:, :, 2], 1, 0)
    sine = np.hypot(x, y)
    psi = np.where(sine > MIN_TILT_SINE, np.arctan2(x, -y), 0.0)
    return [psi, np.arctan2(sine, z)]
