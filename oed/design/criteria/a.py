"""A: the sum of the variances."""

import numpy as np

from oed.design.catalogue import NamedCriterion
from oed.design.forms.variance import Variance

criterion = NamedCriterion(
    name="A",
    about="-trace M^-1: sum of the parameter variances",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="sum of the variances of the parameters, with a minus sign",
    form=lambda columns, _: Variance(np.eye(columns), "A"),
    has_weights=True,
)
