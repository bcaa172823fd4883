"""Subdivision error of a linear encoder: periodic over one signal period of its scale.

Catalogues give up to 1 % of the signal period: 0.2 um of a 20 um grating, 10 um of a
magnetic scale of 1 mm. What the encoder shows is known exactly, so poses far apart see
the period as well as dense ones.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

PERIOD_SHARE = 0.005  # of the period
PERIODS = (10e-6, 20e-6, 30e-6, 40e-6, 100e-6, 200e-6, 1e-3, 2e-3, 5e-3)


def columns(state: State, period: float) -> Iterable[Column]:
    """Sine and cosine of the place within a period a leg; shape: two in a period."""
    return terms.harmonics(state, period, PERIOD_SHARE * period)


effect = Effect(
    name="encoder_subdivision",
    source="catalogues of linear encoders: position error within a signal period up to 1 % of it",
    about="error of each encoder within a signal period",
    columns=columns,
    constants={"period": PERIODS},
    remedy="clean and align the reading head, adjust offset, amplitude and phase of its signals",
    nature=natures.TRAVEL,
    exposed_by="slow, dense readings over a few signal periods",
    unfit=terms.has_rotary_drives,
)
