"""Predicts the residual accuracy over the workspace: the section `prediction`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed import information, prediction, units
from oed.arrays import Array
from oed.identification import Estimate
from oed.kinematics import Kinematics
from oed.measurement import Measurement, Series
from oed.posterior import Posterior
from oed.prediction import Prediction, Reference, Spread
from oed.result import ComponentAccuracy, MapPoint, PredictionSection, SpreadRecord
from pkm_studies.stages import describe


def prediction_section(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
    estimate: Estimate | None,
    posterior: Posterior | None,
    realised: Mapping[str, Spread] | None,
) -> PredictionSection:
    """Accuracy before and after compensation, and the share of virtual machines in it.

    Without an `estimate`, the tolerances and the planned readings predict it; with a
    `posterior`, its draws do, which follow directions that no reading determines.
    `realised` is the accuracy of virtual machines, by component.
    """
    prediction = _predict(
        measurement, series, command, reference, rng, estimate, posterior
    )
    mode = "plan" if estimate is None else "identified"
    section = accuracy_section(measurement.kinematics, prediction, mode)
    if realised is None:
        return section
    spreads = {n: spread_record(s, section.unit[n]) for n, s in realised.items()}
    shares = {n: s.rms / section.components[n].after.rms for n, s in spreads.items()}
    return msgspec.structs.replace(section, realised=spreads, realised_share=shares)


def _predict(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
    estimate: Estimate | None,
    posterior: Posterior | None,
) -> Prediction:
    """The kernel's prediction over commands (n, n_dof)."""
    count = len(measurement.machine.parameters)
    tolerance = measurement.tolerance
    theta, noise, mean = measurement.nominal, measurement.noise(series), None
    if estimate is not None:
        theta, noise = estimate.theta, estimate.noise
        mean = (estimate.theta - measurement.nominal)[:count]
    h = noise.whiten(measurement.jacobian(series, theta)) * tolerance
    draws = None
    if estimate is None:
        scale = np.outer(tolerance[:count], tolerance[:count])
        covariance = information.posterior_covariance(h)[:count, :count] * scale
    elif posterior is None:
        covariance = estimate.covariance[:count, :count]
    else:
        draws = posterior.pooled[:, :count] - estimate.theta[:count]
        covariance = draws.T @ draws / len(draws)
    return prediction.predict(
        prediction.error_maps(measurement.kinematics, command, reference),
        np.diag(tolerance[:count] ** 2),
        covariance,
        rng,
        mean=mean,
        draws=draws,
        reference=reference,
        sources=prediction.budget_sources(h, tolerance, measurement.names, count),
    )


def accuracy_section(
    kinematics: Kinematics, prediction: Prediction, mode: str
) -> PredictionSection:
    """A prediction in the components' fine units; `mode` says what it rests on."""
    machine = kinematics.machine
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    compensatable = {c.name: c.compensatable for c in machine.components}
    components = {
        name: ComponentAccuracy(
            compensatable=compensatable[name],
            before=spread_record(prediction.before[name], fine[name]),
            after=spread_record(prediction.after[name], fine[name]),
            known=spread_record(prediction.fully_corrected[name], fine[name]),
            budget=prediction.budget[name],
        )
        for name in prediction.names
    }
    points = []
    poses = kinematics.inverse(prediction.command)[0]
    _, tips, _ = kinematics.frames(poses, np.zeros(3))
    for i, command in enumerate(prediction.command):
        before = _by_component(prediction, prediction.sd_before[i], fine)
        after = _by_component(prediction, prediction.sd_after[i], fine)
        at = [float(v) for v in tips[i]]
        points.append(
            MapPoint(describe.displayed_command(machine, command), before, after, at)
        )
    return PredictionSection(
        reference=prediction.reference,
        components=components,
        unit=fine,
        poses=len(prediction.command),
        map=points,
        mode=mode,
    )


def _by_component(
    prediction: Prediction, values: Array, fine: Mapping[str, str]
) -> dict[str, float]:
    """Values (k,), SI, by component, in its fine unit."""
    pairs = zip(prediction.names, values, strict=True)
    return {name: units.number(value, fine[name]) for name, value in pairs}


def spread_record(spread: Spread, unit: str) -> SpreadRecord:
    """A spread, SI, in a unit."""
    return SpreadRecord(
        rms=units.number(spread.rms, unit),
        p95=units.number(spread.p95, unit),
        max=units.number(spread.largest, unit),
        unit=unit,
    )
