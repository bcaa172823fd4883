"""Tables of a study file: what follows from their fields, and the limits of these."""

import inspect
from typing import Any

import msgspec
import pytest

from oed import posterior
from pkm_studies.tables import (
    CircleTable,
    CubeTable,
    DesignTable,
    ForecastTable,
    MeasuredTable,
    PlanTable,
    PosteriorTable,
)

CENTRE: dict[str, Any] = {"centre_mm": [0.0, 0.0, 0.0]}
#: a table, its required fields, a field, the ends of its range, and what lies beyond
LIMITS = [
    (CircleTable, CENTRE | {"radius_mm": 1.0}, "arc_deg", [1e-9, 720.0], [0.0, 720.1]),
    (CircleTable, CENTRE, "radius_mm", [1e-9], [0.0]),
    (CubeTable, CENTRE | {"side_mm": 1.0}, "count", [2, 58], [1, 59]),
    (ForecastTable, {"expected": {"z_um": 1.0}}, "nodes", [3, 1000], [2, 1001]),
    (PlanTable, {}, "stages", [1, 12], [0, 13]),
    (PlanTable, {}, "worth", [0.0, 0.999], [-0.001, 1.0]),
    (PosteriorTable, {}, "walkers", [4, 100_000], [3, 100_001]),
]


@pytest.mark.parametrize(("table", "required", "field", "ends", "beyond"), LIMITS)
def test_a_number_is_within_its_limits(table, required, field, ends, beyond):
    for value in ends:
        made = msgspec.convert(required | {field: value}, table)
        assert getattr(made, field) == value
    for value in beyond:
        with pytest.raises(msgspec.ValidationError, match=field):
            msgspec.convert(required | {field: value}, table)


def test_options_of_the_sampler_are_those_that_it_takes():
    table = PosteriorTable(walkers=40, steps=7, ess=5, draws=3, thin=2, sampler="emcee")
    options = table.sampler_options
    assert set(options) <= set(inspect.signature(posterior.sample).parameters)
    assert options["max_steps"] == 7
    assert options["max_draws"] == 3
    assert [options[name] for name in ("walkers", "ess", "thin")] == [40, 5, 2]


def test_only_a_budget_leaves_the_size_of_a_plan_open():
    assert DesignTable(readings=9, budget_min=5.0).size == 9
    assert DesignTable(budget_min=5.0).size is None
    assert DesignTable().size is not None
    shares = {"D": 0.7, "I": 0.3}
    assert DesignTable(compound=shares).criteria == ("D", "I")
    assert DesignTable(compound=shares).judged_by == "compound"
    assert (
        DesignTable(criterion="E").criteria
        == ("E",)
        == (DesignTable(criterion="E").judged_by,)
    )


def test_a_measurement_mounts_its_first_set_up_first():
    measured = MeasuredTable(name="a", counts=[1], setup="cup", setups=["long", "bare"])
    assert measured.mounted == ["cup", "long", "bare"]
    assert MeasuredTable(name="a", counts=[1], setups=["long"]).mounted == ["long"]


def test_a_circle_is_a_whole_turn_in_whole_degrees_unless_stated():
    circle = msgspec.convert(CENTRE | {"radius_mm": 1.0}, CircleTable)
    assert circle.arc_deg == 360.0
    assert circle.arc_deg % circle.count == 0.0
    assert (circle.start_deg, circle.plane, circle.direction) == (0.0, "xy", "ccw")
