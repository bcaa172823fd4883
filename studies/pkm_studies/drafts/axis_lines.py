"""Values of coordinates in a new study, in numbers that a user would write."""

import math
import re

import numpy as np

from oed import units
from oed.base import Array
from oed.model import Coordinate, Machine
from pkm_studies.quantities import column, display_unit
from pkm_studies.tables import PredictionReference

POSES = 1000  #: poses of the grid, at most
VALUES = 5  #: values of a coordinate
FEWER_VALUES = 3  #: values of a coordinate where these are too many poses
#: values where an instrument leaves two coordinates free: enough readings to choose from
MORE_VALUES = 8
TURN_VALUES = 12  #: values of an angle that goes all the way round
#: shares of the workspace that the grid spans: the first whose poses can be measured
SHARES = (0.6, 0.4, 0.25, 0.15, 0.08, 0.04)
HALF_RANGE = 0.1  #: half a range of a coordinate without end, m or rad
ROUNDING_TOLERANCE = 1e-12  #: SI numbers of a geometry below this are rounding errors


def axis(c: Coordinate, machine: Machine, share: float, free: int | None = None) -> str:
    """A coordinate's values; `free`, how many coordinates an instrument leaves free."""
    key = column(c.name, c.unit)
    if turns_round(c, share):
        count = TURN_VALUES
        return (
            f"{key} = {{ from = 0.0, to = 360.0, count = {count}, endpoint = false }}"
        )
    low, high = (
        format_number(end, c.unit) for end in span_of_values(c, machine, share)
    )
    return f"{key} = {{ from = {low}, to = {high}, count = {count_of_values(machine, free)} }}"


def count_of_values(machine: Machine, free: int | None = None) -> int:
    """Values of each coordinate: fewer where six would make 15625 poses."""
    every = len(machine.command)
    free = every if free is None else free
    if free < every and free <= 2:
        return MORE_VALUES if free == 2 else MORE_VALUES**2 // 2
    few = VALUES**free > POSES
    return FEWER_VALUES if few else VALUES


def turns_round(c: Coordinate, share: float) -> bool:
    """Whether an angle goes all the way round: cautious where its range has no end."""
    full_turn = 2.0 * math.pi - 1e-9
    whole = c.unit == "rad" and c.lower <= 0.0 and c.upper >= full_turn
    has_ends = math.isfinite(c.lower) and math.isfinite(c.upper)
    return whole and (share == SHARES[0] or has_ends)


def span_of_values(
    c: Coordinate, machine: Machine, share: float
) -> tuple[float, float]:
    """The middle of a coordinate's range, or a part of it about home."""
    home = machine.home[c.name]
    low = c.lower if np.isfinite(c.lower) else home - HALF_RANGE
    high = c.upper if np.isfinite(c.upper) else home + HALF_RANGE
    centre, half = (low + high) / 2.0, (high - low) / 2.0
    if share == SHARES[0]:
        return centre - share * half, centre + share * half
    return max(home - share * half, low), min(home + share * half, high)


def prediction_table(
    machine: Machine, errors: PredictionReference = "home", share: float = SHARES[0]
) -> str:
    """The table [prediction] over a `share` of the workspace; `errors`: their reference."""
    axes = "\n".join(axis(c, machine, share) for c in machine.command)
    driven = next((c for c in machine.components if c.compensatable), None)
    limit = ""
    if driven is not None:
        key = f"{driven.name}_{units.FINE[driven.unit]}"
        limit = (
            f"# wanted = {{ {key} = 50 }}  # rms error to reach, judged in the report\n"
        )
    return f"""\
[prediction]
reference = "{errors}"  # home, absolute or best_fit
{limit}{axes}
"""


def format_pose(coordinates: tuple[Coordinate, ...], values: Array) -> str:
    fields = [
        f"{column(c.name, c.unit)} = {format_number(value, c.unit)}"
        for c, value in zip(coordinates, values, strict=True)
    ]
    return "{ " + ", ".join(fields) + " }"


def format_number(value: float, si: str) -> str:
    """An SI value as TOML, in the unit of its column."""
    return number_text(value, display_unit(si))


def format_numbers(value: object, si: str) -> str:
    """An SI number, or nested lists of them, as TOML."""
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(format_numbers(item, si) for item in value)}]"
    number = float(value)  # type: ignore[arg-type]
    return format_number(number if abs(number) > ROUNDING_TOLERANCE else 0.0, si)


def number_text(value: float, unit: str) -> str:
    number = f"{float(units.from_si(value, unit)):.9g}"
    return number if re.search(r"[.e]", number) else f"{number}.0"
