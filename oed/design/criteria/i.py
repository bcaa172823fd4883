"""I: the mean variance of the pose over a workspace."""

import numpy as np

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.variance import Variance


def build(columns: int, ingredient: Array | None) -> Variance:
    """-trace(W M^-1), W = F^T F the mean of J^T J over the poses, by its triangle."""
    accuracy = np.asarray(ingredient)
    flat = accuracy.reshape(-1, accuracy.shape[2]) / np.sqrt(len(accuracy))
    if len(flat) > columns:
        flat = np.linalg.qr(flat, mode="r")
    return Variance(np.asarray(flat))


criterion = NamedCriterion(
    name="I",
    about="-trace W M^-1: mean predicted pose variance over the workspace",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="mean variance of the pose over the workspace, with a minus sign",
    form=build,
    needs="accuracy",
)
