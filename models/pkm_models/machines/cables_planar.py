"""Cable robot in the x-y plane with any number of cables: see `pkm_models.machines.parts.cables`.

Geometry (`[machine.geometry]`): anchor, one point a cable; attach, the cables' points
on the mover where it is a body that turns; home, reach and turn of the workspace. By
default four cables hold a point: two more than its coordinates.
"""

from oed.model import Family, Machine
from pkm_models.machines.parts import cables
from pkm_models.machines.parts.families import Geometry

NAME = "cables_planar"
SOURCE = "Pott 2018, Cable-Driven Parallel Robots, Springer: the standard model"
ANCHORS = ((-1.0, -0.8), (1.0, -0.8), (1.0, 0.8), (-1.0, 0.8))
DIMENSIONS = cables.dimensions(2, ANCHORS, None, (0.0, 0.0), 0.5)


def build(geometry: Geometry) -> Machine:
    """A planar cable robot. Raises ValueError where it has too few cables."""
    table = cables.completed(DIMENSIONS, geometry)
    about = "planar cable robot, any number of cables: x, y (and spin) driven"
    return Machine(**cables.build(NAME, SOURCE, table, 2), about=about, family=family)


family = Family(NAME, DIMENSIONS, build)
machine = build({})
