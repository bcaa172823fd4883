"""What knows no machine: arrays, linear algebra, smooth bases, units, text, whole files.

Array            an array of numbers
Index            an array of indices
Orientation      three angles of a platform, by their order
UnitError        a unit that is unknown, or does not fit
covariance_root  a root of a covariance that may be singular
from_si          a value in SI, in another unit
symmetric_root   the symmetric root of a covariance
to_si            a value of a unit, in SI
"""

from typing import TYPE_CHECKING

from oed.base.lazy import door

if TYPE_CHECKING:
    from oed.base.arrays import Array, Index
    from oed.base.linear_algebra import covariance_root, symmetric_root
    from oed.base.orientation import Orientation
    from oed.base.units import UnitError, from_si, to_si
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
