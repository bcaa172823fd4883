"""3-PRS spindle head as its paper models the errors: by the struts' lengths alone.

Wang and Fan (2004), Eqs. (7)-(14), differentiate |P + [R] b_i - R_i| = l_i at a
measured pose and solve for the errors of R_i, b_i and l_i. The planes in which the
revolute joints hold the struts do not occur, so here they stay nominal:

    |v_i(p)| = l_i,        v_i(nominal) . s_i = 0.

A strut of the nominal machine lies in its plane, v_i . s_i = 0, so the slope -v_i .
dR_i / l_i holds no tangential offset of the slider joint: of each limb's six errors
these equations see five, whatever is measured and at however many poses. `prs_spindle`
has the full closure; this machine is for comparison with the paper.
"""

import dataclasses

from oed.model import Expr, Values
from pkm_models.machines import prs_spindle as full


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Strut lengths of the machine as it is, strut planes as drawn; m."""
    drawn = {parameter.name: parameter.nominal for parameter in full.machine.parameters}
    return [
        row
        for i in full.LIMBS
        for row in (full.strut(x, q, p, i), full.plane_distance(x, q, drawn, i))
    ]


machine = dataclasses.replace(
    full.machine,
    name="prs_spindle_struts",
    source="Wang and Fan 2004, Int. J. Mach. Tools Manuf. 44, 1171-1178, Eqs. (7)-(14)",
    about=(
        "3-PRS spindle head, errors in the struts' lengths only, as its paper has them"
    ),
    closure=closure,
    groups=full.machine.groups[
        :1
    ],  # the sliders' offsets are lost one by one, not as a body
)
