"""Prior of a size over decades, with tails that are bounded and free of scale.

An expected size comes from a standard or a catalogue. Most machines are within a factor
of 30 of it, and all such sizes are equally likely. A wrong conversion, a wrong lead or a
loose screw makes an error of any size: one in ten is beyond, equally likely in each
decade. A normal coefficient whose standard deviation is drawn so has a density of about
1 / |beta|: what is far beyond its expected size costs a few nats, not its square, and is
not pulled back.
"""

import dataclasses

import numpy as np

from oed.base import Array

FAR_SHARE = 0.1  #: prior probability that a size is beyond what is usual
#: expected lambda of a form below which its size is taken for none at all
NEGLIGIBLE_ENERGY = 9.0


@dataclasses.dataclass(frozen=True)
class SizePrior:
    """Sizes in steps of half a decade."""

    usual: tuple[float, ...]  #: sizes that are equally likely
    far: tuple[float, ...]  #: sizes beyond, which share `FAR_SHARE` equally

    @property
    def values(self) -> Array:
        """All sizes (S,), in ascending order."""
        return np.array([*self.usual, *self.far])

    @property
    def log_shares(self) -> Array:
        """Log prior (S,) of each size."""
        usual = np.full(len(self.usual), (1.0 - FAR_SHARE) / len(self.usual))
        far = np.full(len(self.far), FAR_SHARE / len(self.far))
        return np.asarray(np.log(np.concatenate([usual, far])))

    def log_visible_shares(self, energy: Array) -> Array:
        """Log prior (a, S) of visible sizes by energies (a,); far keep theirs."""
        groups = []
        for sizes, share in ((self.usual, 1.0 - FAR_SHARE), (self.far, FAR_SHARE)):
            values = np.array(sizes)
            visible = energy[:, None] * values**2 > NEGLIGIBLE_ENERGY
            visible[:, -1] = True
            each = share / visible.sum(axis=1, keepdims=True)
            groups.append(np.where(visible, np.log(each), -np.inf))
        return np.hstack(groups)


_DECADES = tuple(float(f"{m}e{d}") for d in range(2, 5) for m in (1, 3))
#: sizes of effects, in expected sizes: the scales are of a good machine tool, and a
#: printer's errors are ten times as large
EFFECT_SIZES = SizePrior((0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0), (*_DECADES, 1e5))
#: sizes of what no known effect explains, in units of the noise
UNKNOWN_SIZES = SizePrior((0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0), (*_DECADES[1:], 1e5))
