"""Catalogue of the processes that an unknown effect may look like.

Each process is stated as an effect, with columns of falling prior size, so that the
same machinery serves. In the evidence they are made orthogonal to what the parameters
and the selected effects explain: an unknown remainder takes nothing from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from oed.effect import Column, Effect
from oed.gap.forms.processes import load, motion, path, place, temperature, time

SOURCE = (
    "Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464, for discrepancies as"
    " processes"
)


def _process(
    name: str,
    about: str,
    columns: Callable[..., Iterable[Column]],
    **constants: Sequence[float],
) -> Effect:
    """A process as an effect; with a constant `way`, both directions are needed."""
    return Effect(
        name=name,
        source=SOURCE,
        about=about,
        columns=columns,
        constants={n: tuple(v) for n, v in constants.items()},
        needs=("direction: both",) if "way" in constants else (),
    )


#: processes that act on all readings alike, few enough that the other readings still
#: predict each one
BROAD = (
    "over time",
    "joints over time",
    "over the pose",
    "over the travel",
    "coming back",
    "along the runs",
    "with the motion",
    "with the load",
    "with the feed",
)
PROCESSES: Sequence[Effect] = (
    _process("over time", "drift of the readings", time.over_time),
    _process("tool over time", "drift of the tool's place", time.tool_over_time),
    _process("joints over time", "drift of the joints", time.joints_over_time),
    _process(
        "tool growing",
        "the tool longer and shorter along its axis",
        time.tool_growing,
        reach=time.REACHES,
    ),
    _process(
        "with a temperature",
        "an error of the readings with a temperature",
        temperature.over_temperature,
        body=temperature.BODIES,
    ),
    _process(
        "tool with a temperature",
        "the tool displaced with a temperature",
        temperature.tool_over_temperature,
        body=temperature.BODIES,
    ),
    _process(
        "joints with a temperature",
        "joints that change with a temperature",
        temperature.joints_over_temperature,
        body=temperature.BODIES,
    ),
    _process(
        "for a while",
        "a disturbance for part of the session",
        time.windows,
        when=time.CENTRES,
        lasts=time.DURATIONS,
    ),
    _process(
        "at the start of runs",
        "an error that fades after a run's start",
        time.run_start,
        readings=time.STARTS,
    ),
    _process("over the pose", "a smooth error over the workspace", place.over_pose),
    _process(
        "coming back",
        "an error that comes back in the same place",
        place.coming_back,
        reach=place.PATCHES,
    ),
    _process(
        "coming back with",
        "an error that comes back with what changes",
        place.coming_back_with,
        reach=place.PATCHES,
        what=place.WITH,
    ),
    _process("in a run", "an error in one run", path.in_a_run),
    _process(
        "over the travel", "an error of the joints over their travel", place.over_travel
    ),
    _process(
        "along the runs", "harmonics along the runs, with direction", path.over_phase
    ),
    _process(
        "tool along the runs",
        "the tool displaced along the runs, with direction",
        path.tool_over_phase,
    ),
    _process(
        "in a sector",
        "an error in a sector, one way",
        path.in_a_sector,
        centre=path.SECTORS,
        way=(-1.0, 1.0),
    ),
    _process(
        "with the motion",
        "an error with the sign of the joints' motion",
        motion.over_sense,
    ),
    _process(
        "with another's motion",
        "an error of a joint with another's motion",
        motion.of_another,
        shift=motion.SHIFTS,
    ),
    _process("with the load", "an error with the payload", load.over_load),
    _process(
        "parameters with the load",
        "parameters that change with the payload",
        load.parameters_over_load,
    ),
    _process("with the feed", "an error with the feed", load.over_feed),
    _process(
        "tool with the feed", "the tool displaced with the feed", load.tool_over_feed
    ),
)
