"""Cable robot in space with any number of cables: see `pkm_models.machines.parts.cables`.

Geometry (`[machine.geometry]`): anchor, one point a cable; attach, the cables' points
on the mover where it is a body that turns; home, reach and turn of the workspace. By
default eight cables hold a body: two more than its coordinates.
"""

import itertools

from oed.model import Family, Machine
from pkm_models.machines.parts import cables, families
from pkm_models.machines.parts.families import Geometry

NAME = "cables_spatial"
SOURCE = "Pott 2018, Cable-Driven Parallel Robots, Springer: the standard model"
CORNERS = tuple(itertools.product((-1.0, 1.0), repeat=3))
ANCHORS = tuple((2.0 * x, 1.5 * y, 1.25 + 1.25 * z) for x, y, z in CORNERS)
# crossed, so that the cables hold the mover against turns
ENDS = tuple((0.2 * x, -0.15 * y, -0.1 * z) for x, y, z in CORNERS)
DIMENSIONS = cables.dimensions(3, ANCHORS, ENDS, (0.0, 0.0, 1.2), 0.5)


def build(geometry: Geometry) -> Machine:
    """A cable robot in space. Raises ValueError where it has too few cables."""
    ends = {"attach": None} if "anchor" in geometry else {}
    table = families.completed(DIMENSIONS, {**ends, **geometry})
    about = "cable robot in space, any number of cables: x, y, z (and turns) driven"
    return Machine(**cables.build(NAME, SOURCE, table, 3), about=about, family=family)


family = Family(NAME, DIMENSIONS, build)
machine = build({})
