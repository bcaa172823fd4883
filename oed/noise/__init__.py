"""One noise model: covariance of readings, noise law, outliers, their estimation.

LEVEL             a level of unknown size that a run shares
Laws              many noise laws, in units of the stated noise
Noise             the noise of readings, independent or related
NoiseLaw          standard deviations, tails and correlation of noise
ReadingStructure  readings in chains of runs
Whitening         readings of a structure under noise laws
noise_prior       the prior of noise laws, given what is stated
stated_laws       the stated noise, as laws
"""

from typing import TYPE_CHECKING

from oed.base.lazy import door

if TYPE_CHECKING:
    from oed.noise.covariance import Noise
    from oed.noise.law import NoiseLaw
    from oed.noise.prior import noise_prior
    from oed.noise.process import Laws, Whitening, stated_laws
    from oed.noise.structure import LEVEL, ReadingStructure
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
