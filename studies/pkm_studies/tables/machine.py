"""Tables of the machine, its set-ups, the noise and the prior tolerances."""

from typing import Annotated, Literal

import msgspec

from pkm_studies.base import Name
from pkm_studies.tables.base import (
    Count,
    Numbers,
    Pair,
    Positive,
    Share,
    StudyTable,
    Triple,
)

#: what moves the joints of a machine
DriveKind = Literal["screw", "belt", "cable", "gear", "linear_motor"]


class AdjustTable(StudyTable, frozen=True, kw_only=True):
    """[[machine.adjust]]: what moves some parameters at the machine; later tables win.

    parameters   names or patterns of one unit, as in `["dR*x"]`
    by           what to turn, shift or shim; `{i}` stands for the number in the name
    further      with their unit: `step_mm`, the smallest amount; `sd_mm`, how exactly the
                 fitter sets it; `most_mm`, the largest amount to either side
    """

    free_keys = "amounts"
    parameters: list[str]
    by: str
    amounts: dict[str, float] = {}


class DriveTable(StudyTable, frozen=True, kw_only=True):
    """`drive` of [machine] with its numbers, as in `{ kind = "gear", ratio = 50 }`.

    kind     what moves the joints
    ratio    turns of the motor a turn of the joint
    stages   in its place, the ratio of each stage from the joint to the motor
    lead_mm  travel of a screw's nut in a turn
    """

    kind: DriveKind
    ratio: Positive | None = None
    stages: list[Positive] = []
    lead_mm: Positive | None = None


class MachineTable(StudyTable, frozen=True, kw_only=True):
    """[machine]: the model and its numbers.

    model      a name of `oed list machines`, or a file of your own (`my.py:machine`)
    geometry   sizes and joint places of a machine of a family, as in `arm_mm = 350`
    nominal    numbers of your machine in place of the model's, as in `l1_mm = 350`
    workspace  ranges of the command, as in `x_mm = [-100, 100]`
    home       command of the home pose, as in `z_mm = 20`
    travel     ranges of the joints, as in `q1_mm = [0, 600]`
    fixed      parameters that are not identified, in place of the model's list
    drive      what moves the joints, with its gears where they are known; effects that it
               cannot have are left out
    adjust     [[machine.adjust]] tables, in place of the model's adjustments
    controller what the controller holds of an earlier calibration, relative to the study:
               the folder of its result, or a file of `oed compensate --to json|csv`;
               nominal numbers by default
    """

    model: str
    geometry: dict[str, Numbers] = {}
    nominal: dict[str, float] = {}
    workspace: dict[str, Pair] = {}
    home: dict[str, float] = {}
    travel: dict[str, Pair] = {}
    fixed: list[str] | None = None
    drive: DriveKind | DriveTable | None = None
    adjust: list[AdjustTable] | None = None
    controller: str | None = None


class SetupTable(StudyTable, frozen=True, kw_only=True):
    """[[setup]]: an instrument as mounted.

    name             of the set-up
    instrument       a name of `oed list instruments`, or a file of your own
    station          name of what stays in place while set-ups change, such as a tracker that
                     reads several nests: they share its unknowns, and state them alike
    channels         channels that were read, where not all: `["read_x", "read_y"]`
    tool_mm          tool point in the platform's frame
    repeats          how often each planned reading is taken
    both_directions  whether it is taken forward and backward
    average          whether the mean of these passes is the reading
    teach            command at which the instrument was taught
    tolerance        standard deviations of the set-up's unknowns, as in `cup_x_mm = 0.1`
    further          settings of the instrument with their unit, as in `length_mm = 300`
    """

    free_keys = "settings"
    name: Name
    instrument: str
    station: Name | None = None
    channels: list[str] | None = None
    tool_mm: Triple = (0.0, 0.0, 0.0)
    repeats: Count = 1
    both_directions: bool = False
    average: bool = True
    teach: dict[str, float] | None = None
    tolerance: dict[str, float] = {}
    settings: dict[str, float] = {}


class NoiseTable(StudyTable, frozen=True, kw_only=True):
    """[noise]: standard deviation of one reading, and what else is stated of its noise.

    An estimated law is close to what is stated, lacks what is stated as 0, and may have
    much or little of what is not stated.

    assumed         whether the numbers are assumptions, which nobody measured. Estimated
                    is only how far single readings scatter, within a factor of ten; where
                    the readings cannot estimate it, the result says so
    estimate        whether the noise law is estimated from the readings and integrated
                    over; by default where recorded readings leave enough degrees of
                    freedom. Where it is true, up to ten times the stated noise is no bad
                    fit
    carried         share (0 to 1) of the variance of single readings that is carried
                    along a run, as by a slow drift
    reach_readings  readings over which it is carried: 8 where none is stated
    course          whether readings may share a course through the session, as by slow
                    heat; false says that they do not
    student_dof     degrees of freedom (above 2) of a Student t of single readings
    outlier_share   share (0 to 0.5) of readings that are far off
    further         channels with their unit, as in `length_um = 0.5`, for all set-ups, or
                    in a table with the set-up's name for that one; `length_run_um` is the
                    error that all readings of a run share, such as that of a bar put up
                    anew, `length_resolution_um` the step of a display that rounds, and
                    `seating_um` what each coordinate moves by of a cup that each run seats
                    anew
    """

    free_keys = "sigma"
    assumed: bool = False
    estimate: bool | None = None
    carried: Share | None = None
    reach_readings: Positive | None = None
    course: bool = True
    student_dof: Annotated[float, msgspec.Meta(gt=2)] | None = None
    outlier_share: Annotated[float, msgspec.Meta(ge=0, le=0.5)] | None = None
    sigma: dict[str, float | dict[str, float]] = {}


class ControllerTable(StudyTable, frozen=True, kw_only=True):
    """[controller]: the firmware of the machine, for which `oed compensate` writes.

    firmware        format that it reads, as in `oed compensate --to`
    version         of the firmware
    m665_b          what B of Marlin's M665 is: the trim of a rod, the radius of
                    calibration, or nothing
    file            file of the printer that the values belong into, where it is not the
                    usual one, such as config-override.g
    home_offset_mm  height of the nozzle at home over the firmware's home height, which is
                    "not known" where the study has that instead
    probe_z_mm      M851 Z of Marlin, and
    steps_per_mm    M92, which the offset of other versions follows from
    keep            words that are written back as they are, by command
    radius_trim_mm  what the firmware adds to the radius of each tower, and keeps
    rod_trim_mm     what it adds to the arm of each tower, and keeps
    """

    firmware: str
    version: str | None = None
    m665_b: Literal["rod trim", "calibration radius", "not read"] | None = None
    file: str | None = None
    home_offset_mm: float | Literal["not known"] | None = None
    probe_z_mm: float | None = None
    steps_per_mm: Positive | None = None
    keep: dict[str, str] = {}
    radius_trim_mm: Triple = (0.0, 0.0, 0.0)
    rod_trim_mm: Triple = (0.0, 0.0, 0.0)


class ToleranceTable(StudyTable, frozen=True, kw_only=True):
    """[[prior.tolerance]]: a standard deviation for some parameters; later tables win.

    parameters   names or patterns, as in `["dq*"]`
    further      `sigma` with its unit, as in `sigma_mm = 0.1`
    """

    free_keys = "sigma"
    parameters: list[str]
    sigma: dict[str, float] = {}


class CorrelatedTable(StudyTable, frozen=True, kw_only=True):
    """[[prior.correlated]]: parameters of the machine whose errors have a common cause.

    parameters   names or patterns, as in `["dq*"]`
    correlation  between each two of them, below 1: 0.9 for legs of one batch, below 0
                 where one is long if another is short
    """

    parameters: list[str]
    correlation: Annotated[float, msgspec.Meta(gt=-1, lt=1)]


class BoundsTable(StudyTable, frozen=True, kw_only=True):
    """[[prior.bounds]]: values that parameters of the machine cannot pass; later tables win.

    parameters   names or patterns, as in `["dq*"]`
    further      `lower` and `upper`, or one of them, with their unit, as in
                 `lower_mm = 0`: ends of the parameter's value
    """

    free_keys = "ends"
    parameters: list[str]
    ends: dict[str, float] = {}


class PriorTable(StudyTable, frozen=True, kw_only=True):
    """[prior]: tolerances in place of the model's, what they have in common, bounds.

    tolerance   [[prior.tolerance]] tables
    correlated  [[prior.correlated]] tables; later ones win
    bounds      [[prior.bounds]] tables; draws of the posterior, of virtual machines and of
                predictions keep to them, estimates and plans ignore them
    earlier     folder of the result of an earlier session, relative to the study: its
                posterior of the machine's parameters takes the place of nominal numbers
                and tolerances
    from        folders of results of other machines of this model: their mean and spread
                take the place of nominal numbers and tolerances
    """

    tolerance: list[ToleranceTable] = []
    correlated: list[CorrelatedTable] = []
    bounds: list[BoundsTable] = []
    earlier: str | None = None
    from_: list[str] = msgspec.field(name="from", default_factory=list)
