"""Forecast compensation: `forecast` of result.json."""

from __future__ import annotations

from typing import Annotated

import msgspec

from oed.result.record import Record


class ForecastComponent(Record, frozen=True):
    """Errors of one pose component against the reference, in `unit`, as rms.

    expected       what calibration is expected to leave
    planned        what interpolation between the nodes is predicted to leave, before a
                   reading
    measured       errors of the nodes as read
    predicted      what the table is predicted to leave over the workspace, with the ends
                   of its 95 % interval
    left_out       errors of nodes less their prediction by all others; and as predicted
    checked        what the table leaves at nodes that were not fitted; as predicted, the
                   largest one, and the largest error without the table
    """

    unit: str
    expected: float
    planned: float
    measured: float | None = None
    predicted: float | None = None
    low: float | None = None
    high: float | None = None
    left_out: float | None = None
    left_out_predicted: float | None = None
    checked: float | None = None
    checked_predicted: float | None = None
    checked_max: float | None = None
    checked_max_before: float | None = None


class ForecastSection(Record, frozen=True):
    """Which nodes to measure, and what the controller's table leaves.

    components  {component: figures}
    reference   against which errors are stated: home or absolute
    nodes       commands to measure, by column, the most useful one first
    setup       set-up whose times count
    minutes     time of mounting it and of reading all nodes
    readings    number of rows read
    table       nodes of the controller's table along each command coordinate
    sentences   what the figures rest on
    """

    components: dict[str, ForecastComponent]
    reference: str
    nodes: Annotated[list[dict[str, float]], msgspec.Meta(min_length=1)]
    setup: str
    minutes: float
    readings: int = 0
    table: dict[str, int] = {}
    sentences: list[str] = []
