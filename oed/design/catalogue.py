"""The catalogue of criteria: one a file in `oed.design.criteria`.

A criterion of plans is a form (`oed.design.forms`) over the columns of a problem, and
everything about it is asked of that form: whether it is smooth, which bound and which
search it has, how poses are polished by it. Observability indices take the singular
values of the scaled identification matrix H over its identifiable directions.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

from oed.base import Array

if TYPE_CHECKING:
    from oed.design.forms import Criterion

#: what a criterion needs besides its name
Ingredient = Literal["none", "interest", "combination", "accuracy"]
#: the same in a sentence
NEEDED: Mapping[Ingredient, str] = {
    "interest": "directions of interest",
    "combination": "a combination",
    "accuracy": "a workspace",
}
#: ingredients over two columns, on which the properties of a form are asked
EXAMPLES: Mapping[Ingredient, Array] = {
    "interest": np.eye(2)[:, :1],
    "combination": np.ones((1, 2)),
    "accuracy": np.eye(2)[None],
}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class NamedCriterion:
    """A criterion as the catalogue lists it."""

    name: str  #: in a study
    about: str  #: what it is, in a line
    source: str  #: publication
    meaning: str = ""  #: its number, in the words of a report; empty for an index alone
    #: the criterion over n columns with its ingredient; None for an index alone
    form: Callable[[int, Array | None], Criterion] | None = None
    #: its ingredient: directions of interest (n, s), a combination (1, n) or the
    #: accuracy (J, r, n) of r wanted components at J poses
    needs: Ingredient = "none"
    has_weights: bool = False  #: whether every solver of weights serves it
    #: what a sentence calls the number instead of the name, as it stands beside any
    #: criterion
    label: str = ""
    is_log_det: bool = False  #: whether the number is log det: log phi times directions
    power: int = -1  #: phi is the absolute number to this power otherwise
    smaller_is_better: bool = False  #: as for kappa
    #: the number from singular values and the number of readings
    index: Callable[[Array, int], float] | None = None
    index_of_poses: bool = False  #: whether `index` takes the number of poses instead
    index_of_each_plan: bool = False  #: whether each plan is reported with the index
    index_meaning: str = ""  #: the index in the words of the papers that use it
    symbol: str = ""  #: how an index is written; its name where empty

    def build(self, columns: int, ingredient: Array | None = None) -> Criterion:
        """The criterion over some columns. Raises ValueError without its ingredient."""
        if self.form is None:
            raise ValueError(f"{self.name} is an index of readings, and judges no plan")
        if self.needs != "none" and ingredient is None:
            raise ValueError(f"criterion {self.name} needs {NEEDED[self.needs]}")
        return self.form(columns, ingredient)

    @functools.cached_property
    def properties(self) -> Criterion:
        """The criterion over two columns: its properties are those over any number."""
        return self.build(2, EXAMPLES.get(self.needs))

    def phi_ratio(self, value: float, best: float, directions: float) -> float:
        """phi of a plan over phi of another, from their numbers; NaN for a best of 0."""
        if self.is_log_det:
            return float(np.exp((value - best) / directions))
        upper, lower = (value, best) if self.power > 0 else (best, value)
        return float((upper / lower) ** abs(self.power)) if lower else np.nan


#: criteria of a study's own, as a weighted mean
COMPOUND = NamedCriterion(
    name="compound",
    about="a weighted mean of criteria",
    source="",
    meaning="weighted mean of the logarithms of several criteria",
    is_log_det=True,
)


class Catalogue:
    """The criteria of all files in `oed.design.criteria`, by name."""

    @functools.cached_property
    def entries(self) -> dict[str, NamedCriterion]:
        """The criteria in the order of their names."""
        from oed.design import criteria

        listed = pkgutil.iter_modules(criteria.__path__, f"{criteria.__name__}.")
        modules = [importlib.import_module(info.name) for info in listed]
        items = [item for module in modules for item in vars(module).values()]
        named = {item.name: item for item in items if isinstance(item, NamedCriterion)}
        return {name: named[name] for name in sorted(named, key=str.casefold)}

    def __getitem__(self, name: str) -> NamedCriterion:
        return self.entries[name]

    def entry(self, name: str) -> NamedCriterion | None:
        """A criterion, or the compound one; None for a name of another version."""
        return COMPOUND if name == COMPOUND.name else self.entries.get(name)

    def build(
        self, name: str, columns: int, ingredient: Array | None = None
    ) -> Criterion:
        """A criterion by name. Raises ValueError for none, or as its entry."""
        if name not in self.plan_names:
            raise ValueError(
                f"criterion {name!r} is none of {', '.join(self.plan_names)}"
            )
        return self[name].build(columns, ingredient)

    # -- names -------------------------------------------------------------------------
    @property
    def plan_names(self) -> tuple[str, ...]:
        """Names of the criteria that judge a plan."""
        return tuple(n for n, item in self.entries.items() if item.form is not None)

    @property
    def smooth(self) -> tuple[str, ...]:
        """Names of the smooth ones: for branch and bound, files and many machines."""
        return tuple(n for n in self.plan_names if self[n].properties.smooth)

    @property
    def polished(self) -> tuple[str, ...]:
        """Names of those that poses are polished by."""
        return tuple(n for n in self.plan_names if self[n].properties.polished)

    @property
    def weighed(self) -> tuple[str, ...]:
        """Names of those whose weights every solver gives."""
        return tuple(n for n in self.plan_names if self[n].has_weights)

    @property
    def indices(self) -> tuple[str, ...]:
        """Names of the indices of readings."""
        return tuple(n for n, item in self.entries.items() if item.index is not None)

    # -- indices of readings -----------------------------------------------------------
    def index(self, name: str, singular_values: Array, count: int = 0) -> float:
        """An index of singular values (L,). Raises LookupError for what is none."""
        function = self[name].index
        if function is None:
            raise LookupError(f"{name} is no index of readings")
        return function(singular_values, count)

    def observability(self, singular_values: Array, readings: int) -> dict[str, float]:
        """The indices that each plan is reported with, O1 to O5."""
        listed = [name for name in self.indices if self[name].index_of_each_plan]
        return {n: self.index(n, singular_values, readings) for n in listed}

    def symbol(self, name: str) -> str:
        """How an index is written in a table."""
        entry = self.entry(name)
        return name if entry is None else entry.symbol or name

    def sentences(self, values: Mapping[str, float]) -> list[str]:
        """Each index of readings with its value, in a sentence."""
        listed = {name: self.entry(name) for name in values}
        meaning = {n: item.index_meaning if item else n for n, item in listed.items()}
        return [
            f"{self.symbol(name)} = {value:.4g}: {meaning[name]}."
            for name, value in values.items()
        ]


CRITERIA = Catalogue()
