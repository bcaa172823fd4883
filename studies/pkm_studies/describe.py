"""Describes machine, set-ups, package versions and drawing, in display units."""

import importlib.metadata
import platform
import re
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec.structs import replace

import oed
from oed import units
from oed.base import Array
from oed.instrument import Channel, Setup
from oed.measurement import Measurement, Series
from oed.mechanism import Kinematics
from oed.model import Coordinate, Machine
from oed.result import (
    Drawing,
    DrawingLabel,
    MachineInfo,
    Polyline,
    SetupInfo,
    StudyResult,
)
from pkm_studies import quantities
from pkm_studies.study import Study

# Finds the points of a drawing that each parameter moves, and names them.

PARAMETER_STEP = 1e-4  #: change of a parameter, SI, that shows which points it moves
TAKES_PART = 0.5  #: share of the largest movement from which a point takes part
SAME_PLACE = 1e-6  #: points nearer than this are one, m
#: share of the largest slope of an equation from which a parameter is in it
MIN_SLOPE = 1e-9
MAX_ENDS = 2  #: points that the equations of a leg join, at most
MAX_NAMES = 4  #: parameters of one place that are named one by one


def parameter_labels(kinematics: Kinematics, x: Array, q: Array) -> list[DrawingLabel]:
    """Labels at the points of the drawing that parameters move, at a pose (nx,), (nq,).

    The pose and the joints are held, so that a joint centre's error moves that centre
    alone. A parameter that moves no point stands in the middle of the points that its
    closure equations join, such as a leg's ends. Others have no label.
    """
    names = [p.name for p in kinematics.machine.parameters]
    moved = [_moved_point(kinematics, x, q, k) for k in range(len(names))]
    nominal = kinematics.machine.nominal
    by_p = kinematics.equations.slopes(x[None], q[None], nominal)[1][0]
    scale = np.abs(by_p).max(axis=1, keepdims=True)
    in_row = np.abs(by_p) > MIN_SLOPE * scale
    places = list(moved)
    drawn = {k: location for k, location in enumerate(moved) if location is not None}
    for k in range(len(places)):
        rows = np.flatnonzero(in_row[:, k])
        sharing = [j for j in drawn if in_row[rows, j].any()]
        points = {tuple(np.round(drawn[j] / SAME_PLACE)) for j in sharing}
        if k not in drawn and 1 <= len(points) <= MAX_ENDS:
            places[k] = np.array(sorted(points)).mean(axis=0) * SAME_PLACE
    members: dict[tuple[float, ...], list[str]] = {}
    for name, location in zip(names, places, strict=True):
        if location is not None and name not in kinematics.machine.frame:
            key = tuple(np.round(location / SAME_PLACE) * SAME_PLACE)
            members.setdefault(key, []).append(name)
    return [
        DrawingLabel([float(v) for v in location], shortened(group), group)
        for location, group in members.items()
    ]


def shortened(names: Sequence[str]) -> str:
    """Names with a common stem in short: da1x, y, z."""
    stems = list(dict.fromkeys(stem for stem, _ in map(_split, names)))
    phrases = []
    for stem in stems:
        tails = [tail for s, tail in map(_split, names) if s == stem]
        phrases.append(stem + ", ".join(tails))
    if len(phrases) > MAX_NAMES:
        phrases = [*phrases[:MAX_NAMES], f"+{len(phrases) - MAX_NAMES}"]
    return " ".join(phrases)


def _split(name: str) -> tuple[str, str]:
    """Stem and axis of a name: da1x -> da1, x; the axis is empty where there is none."""
    match = re.fullmatch(r"(.*[0-9_])([xyz])", name)
    return (match[1], match[2]) if match else (name, "")


def _moved_point(
    kinematics: Kinematics, x: Array, q: Array, parameter: int
) -> Array | None:
    """The point (3,) of the drawing that the parameter moves; None where it moves none.

    Of several that move alike, such as all of a platform, their mean.
    """
    still = kinematics.machine.nominal
    changed = still.copy()
    changed[parameter] += PARAMETER_STEP
    before, after = (
        [point for line in kinematics.skeleton(x, q, p) for point in line]
        for p in (still, changed)
    )
    if not before:  # a machine without skeleton has no drawing
        return None
    movement = np.linalg.norm(np.array(after) - np.array(before), axis=1)
    if movement.max() < SAME_PLACE:
        return None
    moved = np.array(before)[movement > TAKES_PART * movement.max()]
    distinct = np.unique(np.round(moved / SAME_PLACE), axis=0) * SAME_PLACE
    return np.asarray(distinct.mean(axis=0))


#: packages on which the numbers depend
PACKAGES = (
    "pkm-oed",
    "casadi",
    "numpy",
    "scipy",
    "emcee",
    "arviz-stats",
    "xarray",
    "matplotlib",
    "typst",
)
#: significant digits of displayed values: enough for any reading, and none of the
#: rounding noise of unit conversion
CONVERSION_DIGITS = 12


def machine_info(machine: Machine) -> MachineInfo:
    """The machine with its table of parameters."""
    table: list[dict[str, str | float]] = []
    for p in machine.parameters:
        unit = units.display(p.unit)
        table.append(
            {
                "name": p.name,
                "about": p.about,
                "unit": unit,
                "nominal": _displayed_value(p.nominal, unit),
                "tolerance": _displayed_value(p.tolerance, unit),
            }
        )
    return MachineInfo(
        machine.name, machine.about, machine.source, table, list(machine.frame)
    )


def add_earlier_sessions(
    info: MachineInfo, study: Study, measurement: Measurement
) -> MachineInfo:
    """The table with what controller and prior have from earlier sessions."""
    fixed = measurement.kinematics.held
    rows = []
    for k, (p, row) in enumerate(
        zip(measurement.machine.parameters, info.parameters, strict=True)
    ):
        unit = units.display(p.unit)
        changed = dict(row)
        if study.machine.controller is not None:
            changed["held"] = _displayed_value(float(fixed[k]), unit)
        if p.expected is not None:
            changed["expected"] = _displayed_value(p.expected, unit)
        rows.append(changed)
    return replace(
        info,
        parameters=rows,
        controller=study.machine.controller or "",
        earlier=study.prior.earlier or "",
        fleet=study.prior.from_,
    )


def first_result(study: Study, machine: Machine, seed: int) -> StudyResult:
    """The result of a study before its first step."""
    return StudyResult(
        schema=StudyResult.SCHEMA,
        version=oed.__version__,
        study=study.name,
        title=study.title or study.name,
        question=study.question,
        seed=seed,
        seconds=0.0,
        machine=machine_info(machine),
        study_text=study.text,
    )


def setup_info(
    machine: Machine, setup: Setup, series: Sequence[Series] = ()
) -> SetupInfo:
    """A set-up's numbers, noise and unknowns as used; with those of its readings."""
    instrument = setup.instrument
    measured = [s for s in series if s.setup == setup.name and s.sigma is not None]
    amounts: Sequence[float] = setup.sigma
    about = instrument.about + _passes(setup)
    if measured:
        single = np.concatenate([s.reading_sigma(setup.sigma) for s in measured])
        amounts = [float(v) for v in np.sqrt(np.mean(single**2, axis=0))]
        about += "; each reading has its own noise, of which the rms is stated"
    channel_noise = zip(instrument.channels, amounts, strict=True)
    sigma = {}
    for channel, value in channel_noise:
        unit = units.FINE[channel.unit]
        sigma[f"{channel.name}_{unit}"] = _displayed_value(value, unit)
    unknowns = dict(field(n.name, n.tolerance, n.unit) for n in setup.nuisances)
    return SetupInfo(
        name=setup.name,
        instrument=instrument.name,
        about=about,
        numbers=_numbers(machine, setup),
        sigma=sigma,
        unknowns=unknowns,
    )


def _numbers(machine: Machine, setup: Setup) -> dict[str, float]:
    """Settings, tool point and teach pose, by column."""
    unit = {s.name: s.unit for s in setup.instrument.settings}
    numbers = dict(field(k, value, unit[k]) for k, value in setup.settings.items())
    for axis, value in zip("xyz", setup.tool, strict=True):
        numbers[f"tool_{axis}_mm"] = _displayed_value(value, "mm")
    if setup.teach is not None:
        taught = displayed_command(machine, np.array(setup.teach))
        numbers |= {f"teach_{key}": value for key, value in taught.items()}
    return numbers


def _passes(setup: Setup) -> str:
    count = len(setup.protocol.pass_names)
    if count == 1:
        return ""
    use = "their mean is the reading" if setup.protocol.average else "each is a reading"
    return f"; {count} passes, {use}"


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages on which the numbers depend."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"python": platform.python_version()} | versions


def field(name: str, value: float, si: str) -> tuple[str, float]:
    """The key of an SI value, and the value in the unit of that key: `theta_deg`, 30."""
    unit = quantities.display_unit(si)
    return f"{name}_{unit}", _displayed_value(value, unit)


def displayed_values(
    coordinates: Iterable[Coordinate | Channel], values: Array
) -> dict[str, float]:
    """Values (n,) of coordinates by column; without those that are not known."""
    pairs = zip(coordinates, values, strict=True)
    return dict(field(c.name, float(v), c.unit) for c, v in pairs if np.isfinite(v))


def displayed_command(machine: Machine, command: Array) -> dict[str, float]:
    """A command (n_dof,) by column; empty where only joints are known."""
    return displayed_values(machine.command, command)


def displayed_joints(machine: Machine, q: Array) -> dict[str, float]:
    """Joint values (nq,) by column."""
    return displayed_values(machine.joints, q)


def drawing(measurement: Measurement, series: Sequence[Series]) -> Drawing:
    """The machine at home, and the tool point of each reading."""
    kinematics, machine = measurement.kinematics, measurement.machine
    x, q = kinematics.inverse(machine.home_command)
    skeleton = kinematics.skeleton(x[0], q[0], machine.nominal)
    lines = [
        Polyline("machine", [[float(v) for v in row] for row in line])
        for line in skeleton
    ]
    tips: list[list[float]] = []
    owners: list[str] = []
    bars: list[list[list[float]]] = []
    runs: list[str] = []
    commands: list[dict[str, float]] = []
    for s in series:
        setup = measurement.setups[s.setup]
        poses = measurement.expected_poses(s)
        _, tool_points, _ = kinematics.frames(poses, np.array(setup.tool))
        runs += [str(name) for name in s.run]
        commands += [displayed_command(machine, c) for c in s.reading_commands()]
        for row in s.index:
            tip = [float(v) for v in tool_points[row[0]]]
            tips.append(tip)
            owners.append(s.setup)
            # the other end of what is measured, if it has a place
            place = [setup.settings.get(f"at_{axis}") for axis in "xyz"]
            if len(row) == 2:
                place = tool_points[row[1]].tolist()
            far_end = [float(v) for v in place if v is not None]
            bars.append([far_end, tip] if len(far_end) == len(place) else [])
    labels = parameter_labels(kinematics, x[0], q[0])
    if not any(bars):
        bars = []
    return Drawing(lines, tips, owners, bars, runs, commands, labels)


def _displayed_value(value: float, unit: str) -> float:
    return float(f"{float(units.from_si(value, unit)):.{CONVERSION_DIGITS}g}")
