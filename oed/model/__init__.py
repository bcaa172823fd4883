"""What a machine states: a closure with its parameters, coordinates and parts.

Adjustment       what moves a parameter of a machine, for a fitter
CommonTolerance  parameters whose errors are correlated
Component        a component of the pose error, as a user reads it
Coordinate       a pose, joint or command coordinate: its unit and range
Dimension        an entry of a family's table of geometry
Expr             a CasADi expression
Family           machines of one architecture and any geometry
Machine          a closure with its parameters, joints and workspace
Parameter        a nominal value and its tolerance
PassiveJoint     a joint that no drive moves
PointGroup       joint centres of one body
Start            pose and joints from which Newton's method starts
Strut            ends of a strut, at base and platform
Values           expressions or numbers by the name of their coordinate
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.model.machine import (
        Adjustment,
        CommonTolerance,
        Component,
        Coordinate,
        Dimension,
        Expr,
        Family,
        Machine,
        Parameter,
        PassiveJoint,
        PointGroup,
        Start,
        Strut,
        Values,
    )
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
