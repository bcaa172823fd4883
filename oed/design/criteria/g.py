"""G: the largest variance of the pose over a workspace."""

import numpy as np

from oed.design.catalogue import NamedCriterion
from oed.design.forms.variance import LargestVariance

criterion = NamedCriterion(
    name="G",
    about="-max trace W_j M^-1: largest predicted pose variance",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="largest variance of the pose over the workspace, with a minus sign",
    form=lambda _, ingredient: LargestVariance(np.asarray(ingredient)),
    needs="accuracy",
)
