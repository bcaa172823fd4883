"""Forecast compensation: a field of errors, where to read it, and a controller's table.

JointErrors  errors of driven components by those of the joints: plans nodes, fits readings
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.forecast.error_field import JointErrors
else:
    __getattr__ = door(__name__)
