"""The rotation that a printed formula states, factor by factor by SciPy."""

import numpy as np
from scipy.spatial.transform import Rotation

from oed.base.orientation import Orientation


def rotation(stated: Orientation, angles: dict[str, float]) -> np.ndarray:
    """R (3, 3) of the printed formula, each factor by SciPy: Rx(a) Ry(b) T(c, d)."""
    product = stated.formula.partition(" = ")[2].removesuffix(" e_z")
    whole = Rotation.identity()
    for factor in product.replace("), ", ") ").split(") "):
        symbol, _, names = factor.rstrip(")").partition("(")
        values = [angles[n] for n in names.split(", ")]
        vector = [*values, 0.0] if symbol == "T" else np.eye(3)["xyz".index(symbol[1])]
        scale = 1.0 if symbol == "T" else values[0]
        whole = whole * Rotation.from_rotvec(scale * np.asarray(vector))
    return whole.as_matrix()
