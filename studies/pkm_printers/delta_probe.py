"""Probed points of a delta whose firmware gives the height that it believes in.

At contact the tool is at the trigger height over the bed, while the firmware, with the
geometry it has, believes in (x, y, z). A delta moves along z alike everywhere, so the
trigger height drops out: that command gives the joints, and the reading is 0. Slopes of the
bed are numbers of the machine, so z counts from the bed of a firmware that raises z by them.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import optimize, stats

from oed.base import Array
from oed.text import format_p_value
from pkm_printers.bed_mesh import (
    BedMesh,
    ProbedPoint,
    contact_rows,
    distinct,
    explanations,
    probes_of,
)
from pkm_printers.delta_geometry import FACTORS, SLOPES, DeltaGeometry
from pkm_printers.delta_study import (
    SPARE_HEIGHTS,
    DeltaStudy,
    Offset,
    PrinterGeometry,
    free_tilts,
    noise_table,
)
from pkm_printers.repeated import PooledSpread, heights_by_place, pooled
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, ImportRequest
from pkm_studies.tables import ControllerTable

#: standard deviation of a probed height, the bed's flatness included, um
HEIGHT_UM = 100.0
WITH_SLOPES = "rrf"  #: the firmware that holds slopes of the bed
TILTS = "Effector: a probe beside the nozzle also reads how the effector tilts over the bed."
TILTS_FITTED = (
    "The study has that as six unknowns, of rods of a pair and of carriages that are right by"
    " 0.05 mm over 50 mm (1 mrad, standard deviation). Where it tilts by more, probe with the"
    " nozzle itself, or type the heights of the nozzle at several places too."
)
TILTS_NOT_MODELLED = "The model of a {about} does not have that: where it tilts, probe with the nozzle itself."
TILTS_LEFT_OUT = (
    "These heights are too few for that: the predicted errors do not hold it. Probe twenty"
    " places, or with the nozzle itself."
)
ASSUMED = (
    f"Noise: no place was probed twice, so {HEIGHT_UM:g} um is assumed for one height. Probe one"
    " place ten times (M48, G30 S-1, PROBE_ACCURACY), and give the log with these lines."
)
NOISE = "standard deviation of one reading, the bed's flatness included"

MAX_BED_COORDINATE_MM = 1e4  #: mm; no point of a bed is farther away


def delta_session(
    request: ImportRequest,
    *,
    controller: ControllerTable,
    geometry: PrinterGeometry,
    points: Sequence[ProbedPoint],
    accounts: Sequence[str],
    notes: Sequence[str],
    free: tuple[str, ...] | None = None,
    repeated: Sequence[Sequence[float]] = (),
    meshes: Sequence[BedMesh] = (),
    trigger: float = 0.0,
) -> ImportedSession:
    """Study, readings and statements of probed points.

    accounts       sentences on what became of the words of the files
    notes          further sentences, on places and heights
    free           parameters that a user wants fitted; None for what the firmware holds and
                   the heights can tell
    repeated       further readings of the probe at one place, in lists by place, mm
    meshes         further heights of the same bed; without points, the first one states
                   where the bed is
    trigger        height of the nozzle over the bed at contact, mm; 0 where it drops out
    """
    files, mesh = ", ".join(path.name for path in request.files), request.mesh
    _check_places([*points, *[point for one in meshes for point in one.points]], files)
    meshes, mesh_notes = distinct(meshes)
    mesh_notes += [one.sentence(mesh) for one in meshes]
    mesh_notes += explanations(meshes, "M665 and M666")
    probed = points or [point for one in meshes[:1] for point in one.points]
    spread = pooled([*heights_by_place(points), *repeated])
    free, about_lean = _factors(controller, geometry, probed, free)
    offsets = [point.probe for point in probed]
    tilts = free_tilts(offsets, free, len(probed), geometry)
    about_noise = spread.sentence() if spread else ASSUMED
    about_tilts = tilt_sentences(offsets, tilts, geometry)
    notes = [*mesh_notes, about_noise, *about_lean, *about_tilts, *notes]
    radius = max((one.radius for one in meshes), default=0.0)
    study = DeltaStudy(
        name=request.name,
        controller=controller,
        files=files,
        geometry=geometry,
        free=(*free, *tilts),
        noise=_noise(spread),
        calliper=False,
        probed_radius=max((math.hypot(p.x, p.y) for p in points), default=radius),
        heights=(0.0, 50.0),
        probes=probes_of(points),
        accounts=[*notes, *accounts],
        mesh_setups="".join(
            one.setup_table(is_reference=not points and k == 0)
            for k, one in enumerate(meshes)
        ),
        mesh_radius=radius,
        predict=[one.setup for one in meshes] if mesh == "hold-out" else [],
    )
    rows = contact_rows(points, trigger)
    rows += [row for one in meshes for row in one.rows_at(trigger)]
    counted = f"Readings: {len(points)} points of contact with the bed as set-up probe."
    statements = [
        geometry.sentence(),
        *([counted] if points else []),
        "The geometry must be the one that the printer had while it probed.",
    ]
    return ImportedSession(
        study=study.text(), rows=rows, statements=[*statements, *notes, *accounts]
    )


def _factors(
    controller: ControllerTable,
    geometry: PrinterGeometry,
    probed: Sequence[ProbedPoint],
    wanted: tuple[str, ...] | None,
) -> tuple[tuple[str, ...], list[str]]:
    """Parameters that are fitted, and what heights say of a bed that leans."""
    if not isinstance(geometry, DeltaGeometry):
        return wanted or geometry.of_heights, []
    lean = lean_of(geometry, probed)
    is_many = len(probed) >= LEANING + SPARE_HEIGHTS
    is_clear = lean is not None and (is_many or lean.probability < LEAN_P_VALUE)
    has_lean = controller.firmware == WITH_SLOPES and is_clear
    free = wanted or (FACTORS[LEANING] if has_lean else geometry.of_heights)
    is_fitted = set(SLOPES) <= set(free)
    return free, [lean_sentence(lean, len(probed), is_fitted=is_fitted)]


def _noise(spread: PooledSpread | None) -> str:
    """The table [noise]: of repeated readings, or assumed as the last resort."""
    if spread is None or not spread.is_known:
        return noise_table(NOISE, HEIGHT_UM)
    height = round(1e3 * spread.sigma, 3)
    return noise_table(NOISE, height, freedom=spread.freedom)


def tilt_sentences(
    probes: Iterable[Offset], tilts: Sequence[str], geometry: PrinterGeometry
) -> list[str]:
    """What becomes of the effector's tilts, of probes (2,); `tilts` are fitted."""
    if not any(map(any, probes)):
        return []
    if not geometry.tilting:
        return [f"{TILTS} {TILTS_NOT_MODELLED.format(about=geometry.about)}"]
    return [f"{TILTS} {TILTS_FITTED if tilts else TILTS_LEFT_OUT}"]


def _check_places(points: Sequence[ProbedPoint], files: str) -> None:
    """Raises InputError for a point that no machine has."""
    for point in points:
        position = point.x, point.y, point.z
        if max(map(abs, position)) > MAX_BED_COORDINATE_MM:
            listed = ", ".join(f"{v:g}" for v in position)
            raise InputError(
                f"a point at x, y, z = {listed} mm is on no bed",
                "correct it in a copy of the file",
                file=files,
            )


# Whether heights of a delta show that its bed leans: least squares with the lean and without.
#
# A lean bends the heights almost as errors of the towers' angles and endstops do, so a few
# heights hide it. With residual sums of squares S6 of endstops, radius and two angles, and S8 of
# these with two slopes of the bed, n heights of equal noise without a lean give
#
#     F = (S6 - S8) / 2 / (S8 / (n - 8)),    distributed as F(2, n - 8).

PLAIN = 6  #: factors without the lean
LEANING = 8  #: factors with the lean
#: heights that give the lean with one degree of freedom to spare
MIN_LEAN_HEIGHTS = LEANING + 1
LEAN_P_VALUE = 0.01  #: probability by chance below which a lean is reported
#: standard deviations by which a lean must stand out to be seen
MIN_LEAN_DEVIATIONS = 3.0
#: standard deviation of a lean, times the probed radius and over the noise of a height, from
#: which on the heights hide it
HIDDEN_RATIO = 30.0


@dataclasses.dataclass(frozen=True)
class Lean:
    """What heights say of the lean of their bed.

    slope, sd      (2,) rise along x and y, mm/mm, and its standard deviation
    plain, scatter  estimated noise of a height without a lean and with it, mm
    probability    that heights of a level bed differ as much by chance
    """

    slope: Array
    sd: Array
    plain: float
    scatter: float
    probability: float


def lean_of(geometry: DeltaGeometry, points: Sequence[ProbedPoint]) -> Lean | None:
    """The lean of the bed; None where the heights hide it."""
    if len(points) < MIN_LEAN_HEIGHTS:
        return None
    commands = np.array([[point.x, point.y, point.z] for point in points])
    moved = geometry.travels(commands)

    def heights(change: Array) -> Array:
        """Heights (n,) of the tool over the bed, mm."""
        slope = geometry.bed_slope + change[6:]
        raised = geometry.changed(change[:6]).tool_heights(moved)
        return np.asarray(raised - commands[:, :2] @ slope)

    start = np.zeros(LEANING)
    with_lean = optimize.least_squares(heights, start, x_scale="jac")
    without = optimize.least_squares(
        lambda p: heights(np.append(p, [0.0, 0.0])), start[:PLAIN], x_scale="jac"
    )
    freedom = len(points) - LEANING
    scatter = math.sqrt(2.0 * with_lean.cost / freedom)
    if np.linalg.matrix_rank(with_lean.jac) < LEANING:
        return None
    unit = np.sqrt(np.diag(np.linalg.inv(with_lean.jac.T @ with_lean.jac)))[PLAIN:]
    radius = max(math.hypot(point.x, point.y) for point in points)
    if unit.max() * radius > HIDDEN_RATIO:
        return None
    gain = (without.cost - with_lean.cost) / max(with_lean.cost, 1e-300) * freedom / 2.0
    return Lean(
        slope=geometry.bed_slope + with_lean.x[PLAIN:],
        sd=scatter * unit,
        plain=math.sqrt(2.0 * without.cost / (len(points) - PLAIN)),
        scatter=scatter,
        probability=float(stats.f.sf(gain, 2, freedom)),
    )


def lean_sentence(lean: Lean | None, count: int, *, is_fitted: bool) -> str:
    """What the heights say of the bed, and whether the lean is fitted."""
    if lean is None:
        return (
            f"Bed: these {count} heights cannot tell a bed that leans from errors of the"
            f" towers. At least {MIN_LEAN_HEIGHTS} heights at several radii do, out to the edge."
        )
    shown = ", ".join(
        f"{axis} {100.0 * slope:+.2f} +- {100.0 * sd:.2f} %"
        for axis, slope, sd in zip("xy", lean.slope, lean.sd, strict=True)
    )
    if lean.probability > LEAN_P_VALUE:
        beyond = f"{100.0 * MIN_LEAN_DEVIATIONS * lean.sd.max():.2g}"
        return (
            f"Bed: its rise is {shown}. These heights show a lean that the firmware does not"
            f" know from {beyond} % on, and show none."
        )
    end = "fitted" if is_fitted else "not fitted; a line factors = 8 in the log fits it"
    return (
        f"Bed: it rises by {shown}. Heights scatter by {1e3 * lean.scatter:.3g} um with this"
        f" lean, by {1e3 * lean.plain:.3g} um with the one that the firmware has (probability"
        f" by chance {format_p_value(lean.probability)}); it is {end}."
    )
