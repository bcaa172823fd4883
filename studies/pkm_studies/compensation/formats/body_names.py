"""What MJCF and URDF of a machine share: which machines, names, and draws as a table."""

import csv
import io
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from oed.base import Array
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies.catalogue import Compensation
from pkm_studies.compensation.table_grid import PlatformOnLimbs, platform_on_limbs

#: why a machine has no such model
NEEDS = (
    "its platform must be held by legs, or by struts on carriages or cranks, one a freedom;"
    " hinges that hold a platform and cables are not written"
)
#: radius of struts, and size of platforms, over the machine's lever
STRUT_RADIUS_SHARE = 0.02
#: what both files say of platforms and masses
TRANSLATION = "a platform that only translates has slides in place of parallelograms"
MASSES = "masses are placeholders, no measured ones: replace them"
STEEL_DENSITY = 7850.0


def unfit(machine: Machine) -> str | None:
    """Machines that struts alone describe can be written."""
    skeleton = platform_on_limbs(Kinematics(machine), machine.nominal)
    return NEEDS if skeleton is None else None


def commented(root: ET.Element, lines: Iterable[str]) -> str:
    """XML of a model, below comments, in which no two dashes may follow each other."""
    ET.indent(root)
    comment = "\n".join(lines).replace("--", "- -").replace("--", "- -")
    return f"<!--\n{comment}\n-->\n{ET.tostring(root, encoding='unicode')}\n"


def skeleton_of(content: Compensation, values: Array) -> PlatformOnLimbs:
    """The machine with parameters (np,). Raises LookupError where it has no limbs."""
    skeleton = platform_on_limbs(content.kinematics, values)
    if skeleton is None:
        raise LookupError(NEEDS)
    return skeleton


def draws_table(
    content: Compensation, numbers: Callable[[Array], Mapping[str, float]]
) -> str:
    """CSV of parameters and numbers that vary, a row each draw that assembles."""
    rows = []
    for values in content.draws if content.draws is not None else ():
        try:
            rows.append(_parameters(content, values) | dict(numbers(values)))
        except (AssemblyError, LookupError):
            continue
    if not rows:
        return ""
    names = list(rows[0])
    table = np.array([[row[name] for name in names] for row in rows])
    moving = np.ptp(table, axis=0) > 1e-15
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([name for name, moves in zip(names, moving, strict=True) if moves])
    writer.writerows([[repr(v) for v in row] for row in table[:, moving].tolist()])
    return out.getvalue()


def _parameters(content: Compensation, values: Array) -> dict[str, float]:
    """A draw's parameters, SI: `parameter.l1`."""
    rows = zip(content.machine.parameters, values.tolist(), strict=True)
    return {f"parameter.{p.name}": value for p, value in rows}


def text_of(values: Array) -> str:
    """Numbers of an attribute, to the last digit."""
    return " ".join(repr(float(v) + 0.0) for v in np.atleast_1d(values))
