"""The machine with the study's nominal numbers, and its set-ups as mounted."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed import units
from oed.instrument import Instrument, Protocol, Setup, mount
from oed.measurement import Measurement
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies import catalogue, quantities
from pkm_studies.base import Location
from pkm_studies.quantities import check_not_negative
from pkm_studies.resolve import command_ranges, reach
from pkm_studies.study import Study
from pkm_studies.tables import SetupTable


def mounted_setups(study: Study, kinematics: Kinematics) -> dict[str, Setup]:
    """Every [[setup]] by its name. Raises InputError."""
    location = study.location.key("setup")
    stations: dict[str, Setup] = {}
    setups = {}
    for i, table in enumerate(study.setup):
        setup = _setup(study, table, kinematics, location.item(i))
        setups[table.name] = setup
        first = stations.setdefault(setup.owner, setup)
        if first.nuisances != setup.nuisances or table.station in setups:
            raise (
                location.item(i)
                .key("station")
                .error(
                    "no station of these set-ups",
                    "give all that share it one instrument and the same tolerances, and a"
                    " name that no set-up has",
                    table.station,
                )
            )
    return setups


def _setup(
    study: Study, table: SetupTable, kinematics: Kinematics, location: Location
) -> Setup:
    machine = kinematics.machine
    instrument = _instrument(study, table, machine, location)
    x, y, z = (float(v) for v in units.to_si(table.tool_mm, "mm"))
    setup = mount(
        instrument,
        table.name,
        tool=(x, y, z),
        teach=_teach(table, instrument.reference == "teach", machine, location),
        tolerances=_tolerances(table, instrument, location),
        **_settings(table, instrument, location),  # type: ignore[arg-type]
    )
    protocol = _protocol(table, instrument, location)
    setup = dataclasses.replace(setup, protocol=protocol, station=table.station or "")
    _check_teach_pose(kinematics, setup, location)
    return setup


def _instrument(
    study: Study, table: SetupTable, machine: Machine, location: Location
) -> Instrument:
    """The instrument with the channels it has here. Raises InputError."""
    field = location.key("instrument")
    listed: Instrument = catalogue.instrument(table.instrument, study.origin, field)
    instrument = listed.for_machine(machine)
    reason = instrument.unfit(machine)
    if reason is not None:
        problem = f"it cannot read {machine.name}: {reason}"
        raise field.error(problem, "take another", instrument.name)
    if table.channels is None:
        if instrument.single:
            first = instrument.channels[0].name
            names = ", ".join(c.name for c in instrument.channels)
            problem = f"{instrument.name} reads one channel, and none is named"
            remedy = f'write channels = ["{first}"], or another of {names}'
            raise location.key("channels").error(problem, remedy)
        return instrument
    try:
        return instrument.take_channels(table.channels)
    except ValueError as error:
        remedy = "name the channels that were read"
        raise location.key("channels").error(str(error), remedy) from error


def _settings(
    table: SetupTable, instrument: Instrument, location: Location
) -> dict[str, float]:
    unit_of = {s.name: s.unit for s in instrument.settings}
    settings = quantities.read_values(table.settings, unit_of, location)
    for s in instrument.settings:
        if s.default is None and s.name not in settings:
            key = quantities.column(s.name, s.unit)
            raise location.key(key).error(
                "missing", f"{instrument.name} needs it: {s.about}"
            )
    return settings


def _tolerances(
    table: SetupTable, instrument: Instrument, location: Location
) -> dict[str, float]:
    location = location.key("tolerance")
    unknowns = {n.name: n.unit for n in instrument.nuisances}
    tolerances = quantities.read_values(table.tolerance, unknowns, location)
    for key, value in table.tolerance.items():
        check_not_negative(value, location.key(key))
    return tolerances


def _protocol(
    table: SetupTable, instrument: Instrument, location: Location
) -> Protocol:
    protocol = Protocol(table.repeats, table.both_directions, table.average)
    if len(protocol.pass_names) > 1 and instrument.reference == "run":
        problem = (
            f"{instrument.name} reads against the first pose of a run, so its runs"
            " are not repeated here"
        )
        remedy = "list the repeated runs in the grids"
        raise location.key("repeats").error(problem, remedy, table.repeats)
    return protocol


def _teach(
    table: SetupTable, needs_teaching: bool, machine: Machine, location: Location
) -> list[float] | None:
    """The command (n_dof,) at which the instrument was taught, if it is taught."""
    location = location.key("teach")
    keys = [quantities.column(c.name, c.unit) for c in machine.command]
    example = "teach = { " + ", ".join(f"{key} = 0" for key in keys) + " }"
    if table.teach is None:
        if needs_teaching:
            remedy = f"say where {table.instrument} was taught: {example}"
            raise location.error("missing", remedy)
        return None
    if not needs_teaching:
        raise location.error(f"{table.instrument} is not taught", "remove teach")
    values = quantities.read_values(
        table.teach, command_ranges.command_units(machine), location
    )
    for c, key in zip(machine.command, keys, strict=True):
        if c.name not in values:
            raise location.key(key).error(
                "missing", f"give every coordinate: {example}"
            )
    return [values[c.name] for c in machine.command]


def _check_teach_pose(kinematics: Kinematics, setup: Setup, location: Location) -> None:
    """A teach pose may lie outside the workspace, but the machine must reach it."""
    if setup.teach is None:
        return
    location = location.key("teach")
    machine = kinematics.machine
    command = np.array([setup.teach])
    try:
        series = Measurement(machine, [setup], kinematics).series(setup.name, command)
    except AssemblyError as error:
        problem = reach.reach_problem(error, machine)
        raise location.error(problem, "give a pose the machine can reach") from error
    reach.check_joint_range(machine, series.command, series.q, location)
