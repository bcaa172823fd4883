"""The noise of readings: what is stated of it, noise laws, covariance in linear time.

NOTHING_STATED    the statement of an instrument that states single readings alone
Errors            errors of readings in order: white, correlated along a run, shared
FactoredNoise     noise that is related within runs, by the root of its covariance
LawNoise          noise of readings under a noise law
Laws              many noise laws, in units of the stated noise
LinearFactor      root of a covariance in time linear in the number of readings
Noise             the noise of readings, independent or related
NoiseLaw          one law with its level and the tails of single readings
NoiseStatement    what a data sheet or a test states beyond the scatter of readings
ReadingStructure  readings in chains of runs
SharedError       kinds of errors that a run shares
SharedFactor      root of I + U U^T, for errors U that readings share
reach_phrase      how far an error is correlated along a run, in words
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.noise.banded import SharedFactor
    from oed.noise.covariance import FactoredNoise, Noise
    from oed.noise.factor import Errors, LinearFactor
    from oed.noise.laws import LawNoise, Laws, NoiseLaw, reach_phrase
    from oed.noise.statement import NOTHING_STATED, NoiseStatement
    from oed.noise.structure import ReadingStructure, SharedError
else:
    # imported when first used: a model needs the statement alone
    __getattr__ = door(__name__)
