"""Every machine and every machine x instrument under test: what is listed here, the
conformance suite takes up.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import numpy as np

from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import Kinematics
from oed.model.instrument import Setup, mount
from oed.model.machine import Machine
from pkm_models.instruments import (
    ball_bar,
    ball_plate,
    calliper,
    camera,
    height_probe,
    laser_ball_bar,
    length_gauge,
    orientation,
    passive_joint,
    pose_tracker,
    redundancy,
    relative,
    seat,
    touch_plane,
)
from pkm_models.machines import (
    a3_head,
    cable_robot,
    hexaglide,
    hexapod,
    linear_delta,
    micro_cmm,
    planar_2dof,
    prs_spindle,
    prs_spindle_struts,
)


@dataclasses.dataclass(frozen=True)
class Case:
    """A machine, random commands (n, n_dof) over its workspace, commands out of reach,
    and set-ups that can read it.
    """

    machine: Machine
    commands: Callable[[np.random.Generator, int], np.ndarray]
    out_of_reach: np.ndarray
    setups: Mapping[str, Setup]


def _a3_commands(rng: np.random.Generator, n: int) -> np.ndarray:
    """Whole stroke, all psi, theta up to 40 deg; among them the upright pose."""
    c = np.column_stack(
        [
            rng.uniform(1.066, 1.266, n),
            rng.uniform(-np.pi, np.pi, n),
            np.deg2rad(rng.uniform(0, 40, n)),
        ]
    )
    c[0, 1:] = 0.0
    return c


def _delta_commands(rng: np.random.Generator, n: int) -> np.ndarray:
    """A cylinder of 140 mm radius."""
    r, angle = 0.140 * np.sqrt(rng.uniform(size=n)), rng.uniform(-np.pi, np.pi, n)
    return np.column_stack(
        [r * np.cos(angle), r * np.sin(angle), rng.uniform(0.0, 0.400, n)]
    )


def _box_commands(machine: Machine) -> Callable[[np.random.Generator, int], np.ndarray]:
    """The whole workspace of a machine whose coordinates are independent; the first
    pose is home.
    """

    def commands(rng: np.random.Generator, n: int) -> np.ndarray:
        c = rng.uniform(
            [c.lower for c in machine.command],
            [c.upper for c in machine.command],
            (n, len(machine.home)),
        )
        c[0] = machine.home_command
        return c

    return commands


def _setups(
    cup: tuple[float, float, float], teach: tuple[float, ...]
) -> dict[str, Setup]:
    at = dict(zip(("at_x", "at_y", "at_z"), cup, strict=True))
    tool = (0.01, -0.02, 0.05)
    setups = (
        mount(ball_bar.instrument, "ball_bar", teach=teach),
        mount(ball_bar.free_cup, "ball_bar_free_cup", tool=tool, **at),
        mount(height_probe.instrument, "height_probe", tool=tool),
        mount(height_probe.contact, "contact_probe", tool=tool, bed_slope_x=6e-3),
        mount(length_gauge.instrument, "length_gauge", tool=tool, at_z=cup[2]),
        mount(calliper.instrument, "calliper"),
        mount(camera.instrument, "camera", tool=tool),
        mount(camera.known_frame, "camera_known_frame"),
        mount(ball_plate.instrument, "ball_plate", at_x=0.01, at_z=-0.2),
        mount(ball_plate.distance, "ball_distance"),
    )
    return {s.name: s for s in setups}


def _prs_commands(rng: np.random.Generator, n: int) -> np.ndarray:
    """Whole stroke, tilt up to 35 deg in any direction; among them the upright pose."""
    tilt, around = (
        np.deg2rad(35) * np.sqrt(rng.uniform(size=n)),
        rng.uniform(-np.pi, np.pi, n),
    )
    c = np.column_stack(
        [rng.uniform(0.0, 0.4, n), tilt * np.cos(around), tilt * np.sin(around)]
    )
    c[0, 1:] = 0.0
    return c


def _with_trackers(
    setups: Mapping[str, Setup], gimbal: tuple[float, float, float]
) -> dict[str, Setup]:
    """Set-ups with those that read the orientation or stand on a gimbal."""
    at = dict(zip(("at_x", "at_y", "at_z"), gimbal, strict=True))
    tool = (0.01, -0.02, 0.05)
    more = (
        mount(laser_ball_bar.instrument, "laser_ball_bar", **at),
        mount(laser_ball_bar.position, "laser_ball_bar_position", tool=tool, **at),
        mount(pose_tracker.instrument, "pose_tracker", tool=tool),
        mount(pose_tracker.position, "pose_tracker_position"),
        *_of_orientation(),
    )
    return {**setups, **{s.name: s for s in more}}


def _of_orientation() -> list[Setup]:
    """Level, dial gauge and autocollimator, with their zeros freed."""
    kinds = (orientation.instrument, orientation.level, orientation.autocollimator)
    return [
        mount(k, k.name, tolerances={p.name: 1e-5 for p in k.nuisances}) for k in kinds
    ]


def _lines() -> dict[str, Setup]:
    """RM 1 to 5, with the rulers' tilts freed."""
    kinds = {n: getattr(relative, n) for n in ("rm1", "rm2", "rm3", "rm4", "rm5")}
    return {
        n: mount(k, n, tolerances={p.name: 1e-4 for p in k.nuisances})
        for n, k in kinds.items()
    }


_A3 = _setups((0.0, 0.0, 1.40), (1.40, 0.0, 0.0))
_PRS = _with_trackers(_setups((0.0, 0.0, -0.10), (-0.05, 0.0, 0.0)), (0.0, -0.7, 0.1))

CASES = {
    "a3_head": Case(
        machine=a3_head.machine,
        commands=_a3_commands,
        out_of_reach=np.array([[0.526, 0.0, 0.0]]),  # strut length 0
        setups=_with_trackers(_A3, (0.0, -1.0, 1.0)),
    ),
    "linear_delta": Case(
        machine=linear_delta.machine,
        commands=_delta_commands,
        out_of_reach=np.array([[0.5, 0.0, 0.02]]),
        setups=_setups((0.02, 0.01, -0.08), (0.02, 0.01, -0.08)),
    ),
    "micro_cmm": Case(
        machine=micro_cmm.machine,
        commands=_box_commands(micro_cmm.machine),
        out_of_reach=np.array([[0.140, 0.0, 0.0]]),  # leg 1 of length 0
        setups=_setups((0.02, 0.01, -0.40), (0.02, 0.01, -0.40)),
    ),
    "hexapod": Case(
        machine=hexapod.machine,
        commands=_box_commands(hexapod.machine),
        out_of_reach=np.array(
            [[*(np.array(hexapod.B[1]) - hexapod.A[1]), 0.0, 0.0, 0.0]]
        ),  # leg 1 of length 0
        setups=_setups((0.02, 0.01, 0.20), (0.0, 0.05, 0.30, 0.05, 0.0, 0.1)),
    ),
    "hexaglide": Case(
        machine=hexaglide.machine,
        commands=_box_commands(hexaglide.machine),
        out_of_reach=np.array(
            [[0.0, 0.5, -0.4, 0.0, 0.0, 0.0]]
        ),  # 1.3 m from guide 1, whose struts are 0.8 m long
        setups=_setups((0.02, 0.01, 0.0), (0.0, 0.05, 0.15, 0.05, 0.0, 0.1)),
    ),
    "cable_robot": Case(
        machine=cable_robot.machine,
        commands=_box_commands(cable_robot.machine),
        out_of_reach=np.array([cable_robot.ANCHOR[4]]),  # line D of length 0
        setups=_setups((0.2, 0.1, -0.40), (0.2, 0.1, -0.40))
        | {"redundancy": mount(redundancy.instrument, "redundancy")},
    ),
    "planar_2dof": Case(
        machine=planar_2dof.machine,
        commands=_box_commands(planar_2dof.machine),
        out_of_reach=np.array(
            [[1.7, 0.5]]
        ),  # 3.49 m from guide 1, whose strut is 3.35 m long
        setups=_lines() | _setups((0.0, 0.2, -0.3), (0.2, -0.3)),
    ),
    "prs_spindle": Case(
        machine=prs_spindle.machine,
        commands=_prs_commands,
        out_of_reach=np.array([[0.2, np.deg2rad(88.0), 0.0]]),
        setups=_PRS,
    ),
    "prs_spindle_struts": Case(
        machine=prs_spindle_struts.machine,
        commands=_prs_commands,
        out_of_reach=np.array([[0.2, np.deg2rad(88.0), 0.0]]),
        setups=_PRS,
    ),
}
PASSIVE = ("a3_head", "hexapod", "linear_delta", "micro_cmm", "prs_spindle")


def _of_constraints(machine: Machine) -> dict[str, Setup]:
    """Sensors on passive joints, one of them locked, a plane; a seat where it can move."""
    sensors = passive_joint.instrument.for_machine(machine)
    lock = passive_joint.locked.for_machine(machine).take_channels(["off_swing2"])
    slope = {"normal_x": 0.36, "normal_y": -0.48, "normal_z": 0.8}
    setups = [
        mount(sensors.take_channels(["swing1", "swing2"]), "passive_joint"),
        mount(lock, "locked_joint", at_swing2=0.1),
        mount(touch_plane.instrument, "touch_plane", at=0.1, **slope),
    ]
    if len(machine.command) > 3:
        place = {"at_x": 0.01, "at_y": -0.02, "at_z": 0.5}
        setups.append(mount(seat.instrument, "seat", tool=(0.0, 0.0, -0.05), **place))
    return {setup.name: setup for setup in setups}


for _name in PASSIVE:
    _case = CASES[_name]
    CASES[_name] = dataclasses.replace(
        _case, setups={**_case.setups, **_of_constraints(_case.machine)}
    )
PAIRS = [(name, setup) for name, case in CASES.items() for setup in case.setups]


@functools.cache
def _kinematics(machine: str) -> Kinematics:
    """Compiled once for all tests of a process."""
    return Kinematics(CASES[machine].machine)


@functools.cache
def _measurement(machine: str, setup: str) -> Measurement:
    """Compiled once for all tests of a process; they leave it as it is."""
    case = CASES[machine]
    return Measurement(case.machine, [case.setups[setup]], _kinematics(machine))


def reading_series(
    case: Case, setup: str, rng: np.random.Generator, n: int
) -> tuple[Measurement, Series]:
    """A measurement of one set-up and n readings at random poses; in runs of five where
    a run has a reference.
    """
    measurement = _measurement(case.machine.name, setup)
    per_run = 5
    extra = n // per_run if case.setups[setup].instrument.reference == "run" else 0
    runs = [str(i // (per_run + 1)) for i in range(n + extra)] if extra else None
    return measurement, measurement.series(
        setup, case.commands(rng, n + extra), run=runs
    )
