"""What a model may lack: effects, the state that they depend on, and their sizes.

Column         one coefficient of an effect
EFFECT_SIZES   how large effects are thought to be
Effect         an effect outside the model
FAR_SHARE      prior probability that a size is beyond what is usual
State          the state of a machine at poses of a set-up
UNKNOWN_SIZES  how large what no known effect explains is thought to be
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.effect_model.effect import Column, Effect, State
    from oed.effect_model.size_prior import EFFECT_SIZES, FAR_SHARE, UNKNOWN_SIZES
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
