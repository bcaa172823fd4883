"""The steps that predict accuracy: after the fit or the plan, its budget, and held-out readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import get_args

import numpy as np
from msgspec.structs import replace

from oed import posterior, trust, units
from oed.accuracy import (
    Budget,
    BudgetModel,
    Prediction,
    Reference,
    Spread,
    driven_errors,
)
from oed.base import Array
from oed.effect_model import EFFECT_SIZES
from oed.effects import ExpectedEffects, SessionStates
from oed.estimation import Estimate, fit_machines
from oed.gap import assemble
from oed.instrument import Channel
from oed.measurement import Measurement, Series, draw_parameters, reading_structure
from oed.mechanism import Kinematics
from oed.model import Machine
from oed.noise import Laws
from oed.posterior import ApproximateDraws
from oed.result import (
    BudgetLine,
    BudgetSection,
    ComponentAccuracy,
    HeldOutSection,
    HeldOutVerdict,
    MapPoint,
    PredictionSection,
    SpreadRecord,
    ToolAccuracy,
    UnmodelledLine,
    UsualEffects,
)
from oed.units import MM
from pkm_studies import describe
from pkm_studies.base import Stream
from pkm_studies.resolve import PredictionRequest
from pkm_studies.results import advice_on, error_ratio
from pkm_studies.stages.fit.estimate import session_states
from pkm_studies.stages.gap.diagnosis import empty_readings
from pkm_studies.stages.predict import knowledge
from pkm_studies.stages.predict.knowledge import Accuracy, ParameterKnowledge
from pkm_studies.stages.run_state import (
    Fitted,
    HeldOut,
    Measured,
    Scheduled,
    ScheduledT,
)


# Reports the predicted accuracy over the workspace: the section `prediction`.
def accuracy_section(
    kinematics: Kinematics,
    prediction: Prediction,
    mode: str,
    budget: Budget | None = None,
) -> PredictionSection:
    """A prediction in the components' fine units; `mode` says what it rests on."""
    machine = kinematics.machine
    of_sources = {} if budget is None else budget.shares()
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    components = component_accuracies(machine, prediction, of_sources)
    points = []
    poses = kinematics.inverse(prediction.command)[0]
    _, tips, _ = kinematics.frames(poses, np.zeros(3))
    for i, command in enumerate(prediction.command):
        before = _fine_values(prediction.names, prediction.sd_before[i], fine)
        after = _fine_values(prediction.names, prediction.sd_after[i], fine)
        tip = [float(v) for v in tips[i]]
        points.append(
            MapPoint(describe.displayed_command(machine, command), before, after, tip)
        )
    return PredictionSection(
        reference=prediction.reference,
        components=components,
        unit=fine,
        poses=len(prediction.command),
        map=points,
        mode=mode,
        worst={
            name: points[int(np.argmax(prediction.sd_after[:, k]))]
            for k, name in enumerate(prediction.names)
        },
    )


def component_accuracies(
    machine: Machine, prediction: Prediction, of_sources: Mapping[str, dict[str, float]]
) -> dict[str, ComponentAccuracy]:
    """A prediction by component in its fine unit, with shares of sources."""
    before, after, known = (
        spread_records(machine, spreads)
        for spreads in (prediction.before, prediction.after, prediction.fully_corrected)
    )
    return {
        c.name: ComponentAccuracy(
            compensatable=c.compensatable,
            before=before[c.name],
            after=after[c.name],
            known=known[c.name],
            budget=of_sources.get(c.name, {}),
        )
        for c in machine.components
    }


def add_wanted(
    section: PredictionSection, wanted: Mapping[str, float]
) -> PredictionSection:
    """The section with the rms errors to reach, given in SI by component."""
    fine = {name: units.number(v, section.unit[name]) for name, v in wanted.items()}
    return replace(section, wanted=fine)


def spread_records(
    machine: Machine, spreads: Mapping[str, Spread]
) -> dict[str, SpreadRecord]:
    """Spreads by component, SI, in its fine unit."""
    return {
        c.name: spread_record(spreads[c.name], units.FINE[c.unit])
        for c in machine.components
    }


def spread_record(spread: Spread, unit: str) -> SpreadRecord:
    """A spread, SI, in a unit."""

    def interval(ends: tuple[float, float]) -> tuple[float, float] | None:
        if not np.isfinite(ends).all():
            return None
        return units.number(ends[0], unit), units.number(ends[1], unit)

    return SpreadRecord(
        rms=units.number(spread.rms, unit),
        p95=units.number(spread.p95, unit),
        max=units.number(spread.largest, unit),
        unit=unit,
        rms_interval=interval(spread.rms_interval),
        p95_interval=interval(spread.p95_interval),
        max_interval=interval(spread.largest_interval),
        rms_quantiles=[units.number(q, unit) for q in spread.rms_quantiles],
        monte_carlo={
            name.replace("largest", "max"): [units.number(e, unit) for e in errors]
            for name, errors in spread.monte_carlo.items()
        },
    )


# Reports the uncertainty budget, and what to improve first: `prediction.budget`.

#: largest usual size of an effect that the model lacks, in expected sizes
FAR = EFFECT_SIZES.usual[-1]


def budget_section(
    machine: Machine,
    prediction: Prediction,
    budget: Budget,
    expected: ExpectedEffects | None = None,
) -> BudgetSection:
    """The budget in the components' fine units, with effects that are not modelled."""
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    driven = {c.name: fine[c.name] for c in machine.components if c.compensatable}
    lines = [_line(budget, k, fine) for k in range(len(budget.lines))]
    predicted = _fine_values(budget.names, np.sqrt(budget.variance), fine)
    after = np.array([prediction.after[name].rms for name in budget.names])
    effects = [] if expected is None else expected.effects
    unmodelled = []
    for one in effects:
        variance = one.variance.mean(axis=0)
        sizes = {
            "size": np.sqrt(variance),
            "with_it": np.sqrt(after**2 + variance),
            "far": np.sqrt(after**2 + FAR**2 * variance),
            "without": np.sqrt(one.without.mean(axis=0)),
        }
        line = UnmodelledLine(
            effect=one.effect.name,
            about=one.effect.about,
            expected=one.size_text,
            remedy=one.effect.remedy,
            not_testable=one.not_testable,
            **{n: _fine_values(budget.names, v, fine) for n, v in sizes.items()},
        )
        unmodelled.append(line)
    shown, usual = driven or fine, None
    if expected is not None:  # the machine with all effects, fitted beside the geometry
        prediction = expected.prediction
        records = component_accuracies(machine, prediction, {})
        unfitted = np.sqrt(after**2 + expected.added.mean(axis=0))
        errors = dict(zip(prediction.names, unfitted, strict=True))
        usual = UsualEffects(
            effects=[effect.effect.name for effect in expected.effects],
            unmodelled={n: units.number(errors[n], unit) for n, unit in shown.items()},
            fitted={name: records[name].known.rms for name in shown},
            components=records,
        )
    geometry = _fine_values(budget.names, after, fine)
    unmodelled.sort(key=lambda line: error_ratio(line.without, geometry, driven))
    return BudgetSection(
        predicted=dict(predicted),
        lines=lines,
        unmodelled=unmodelled,
        usual=usual,
        advice=advice_on(lines, predicted, shown),
        no_axes={n: v for n, v in geometry.items() if n not in driven},
    )


def _fine_values(
    names: Sequence[str], values: Array, fine: Mapping[str, str]
) -> dict[str, float]:
    """Values (k,), SI, by component, in its fine unit."""
    pairs = zip(names, values, strict=True)
    return {name: units.number(value, fine[name]) for name, value in pairs}


def _line(budget: Budget, number: int, fine: Mapping[str, str]) -> BudgetLine:
    names, line = budget.names, budget.lines[number]
    share = np.zeros_like(budget.variance)
    np.divide(line.variance, budget.variance, out=share, where=budget.variance > 0.0)
    size = np.sign(line.variance) * np.sqrt(np.abs(line.variance))
    without, halved = (
        None if values is None else _fine_values(names, values, fine)
        for values in (line.without, line.halved)
    )
    return BudgetLine(
        source=line.source,
        kind=line.kind,
        share=dict(zip(names, share.tolist(), strict=True)),
        size=_fine_values(names, size, fine),
        without=without,
        halved=halved,
    )


# Compares held-out readings with their predictive intervals: the section `held_out`.
#
# A new mounting adds unknowns of its own, such as a probe's offset, which no earlier
# reading can know. They alone are fitted to the held-out readings, within their
# tolerances, in readings and draws alike: r = Q (y - f), and the interval is that of
# Q (y* - f), with Q = 1 - J_s (J_s^T W J_s + Lambda_s^-1)^-1 J_s^T W.
#
# The verdict compares with readings drawn from the prediction itself, so that errors which
# all readings share count as such. The share inside the 95 % intervals is too low where
# fewer than `RARE` of the draws have a lower one. The ratio of the rms after the fit to
# that before it contradicts the fit where few draws have a larger one, and confirms it
# where few draws of the nominal numbers have a smaller one.

INTERVAL = (0.025, 0.975)  #: ends of a 95 % interval
RARE_SHARE = 0.01  #: share of draws that are rarer than chance
READ_AGAIN = (
    "Either they were read with other numbers in the machine than stated, such as a bed"
    " mesh probed before the last calibration was saved, or the fit is wrong: read them"
    " again before its numbers are used"
)


@dataclasses.dataclass(frozen=True, eq=False)
class HypothesisDraws:
    """Draws of the machine by one fit."""

    estimate: Estimate  #: the fit
    theta: Array  #: (m, n) parameters, SI
    law: Array  #: (m, d) coordinates of the noise law
    #: (m, N) of the held-out readings by effects, SI; None without
    changes: Array | None = None

    def readings(self, measurement: Measurement, series: Series, start: int) -> Array:
        """Readings (m, k) of a series, the held-out ones from `start` on, SI."""
        predicted = measurement.readings([series], self.theta)
        if self.changes is None:
            return predicted
        return predicted + self.changes[:, start : start + predicted.shape[1]]


def held_out_sections(
    measurement: Measurement,
    held_out: HeldOut,
    drawn: Sequence[HypothesisDraws],
    rng: np.random.Generator,
) -> list[HeldOutSection]:
    """One section for each held-out series and channel; draws by hypotheses."""
    mean = np.vstack([machines.theta for machines in drawn]).mean(axis=0)
    sections = []
    start = 0
    for s in held_out.series:
        channels = measurement.setups[s.setup].instrument.channels
        readings = held_out.y[start : start + len(s) * len(channels)]
        predicted = np.vstack([m.readings(measurement, s, start) for m in drawn])
        start += len(readings)
        noise = np.vstack([_noise_draws(measurement, s, m, rng) for m in drawn])
        centre = predicted.mean(axis=0)
        # Q takes the set-up's unknowns out of its readings
        of_setup = np.array([n.startswith(f"{s.setup}.") for n in measurement.names])
        columns = of_setup & measurement.free
        slope = measurement.jacobian([s], mean)[:, columns]
        law = measurement.noise([s])
        white = law.whiten(slope)
        precision = white.T @ white + np.diag(measurement.tolerance[columns] ** -2.0)
        weight = white.T @ law.whiten(np.eye(len(slope)))
        adjust = np.eye(len(slope)) - slope @ np.linalg.solve(precision, weight)
        draws = (predicted + noise - centre) @ adjust.T
        low, high = np.quantile(draws, INTERVAL, axis=0)
        raw = readings - centre
        before = readings - measurement.readings([s], measurement.nominal)
        whole = HeldOutComparison(
            residual=adjust @ raw,
            before=adjust @ before,
            low=low,
            high=high,
            draws=draws,
            noise=noise @ adjust.T,
        )
        for k, channel in enumerate(channels):
            members = slice(k, None, len(channels))
            sections.append(
                _held_out_section(s.setup, channel, whole.take(members), raw[members])
            )
    return sections


def _held_out_section(
    setup: str, channel: Channel, compared: HeldOutComparison, raw: Array
) -> HeldOutSection:
    unit = units.FINE[channel.unit]
    residual = compared.residual
    half_widths = (compared.high - compared.low) / 2.0
    return HeldOutSection(
        name=setup,
        channel=channel.name,
        n=len(residual),
        rms=_rms_in(residual, unit),
        rms_raw=_rms_in(raw, unit),
        unit=unit,
        coverage=compared.coverage,
        residuals=[units.number(v, unit) for v in residual],
        half_widths=[units.number(v, unit) for v in half_widths],
        predicted=_rms_in(compared.draws, unit),
        rms_before=_rms_in(compared.before, unit),
        verdict=compared.verdict,
        words=compared.words(setup, channel.name, unit),
    )


def _rms_in(values: Array, unit: str) -> float:
    return units.number(_rms(values), unit)


def _noise_draws(
    measurement: Measurement,
    series: Series,
    drawn: HypothesisDraws,
    rng: np.random.Generator,
) -> Array:
    """Errors (m, N), SI, of new readings: one for each draw of the noise law."""
    structure = reading_structure(measurement, [series], drawn.theta[0])
    laws = Laws.stated(structure, len(drawn.law), drawn.estimate.scatter)
    fitted = drawn.estimate.noise_posterior
    if fitted is not None:
        law = fitted.prior.laws(drawn.law)
        kinds = [_channel_kind(measurement, n) for n in fitted.structure.names]
        scale = np.ones((len(drawn.law), len(structure.names)))
        for k, name in enumerate(structure.names):
            kind = _channel_kind(measurement, name)
            if kind in kinds:
                scale[:, k] = law.scale[:, kinds.index(kind)]
        laws = dataclasses.replace(law, scale=scale)
    errors = laws.whitening(structure).draw(
        rng, structure.statement, estimated=fitted is not None
    )
    return structure.restore(errors)


def _channel_kind(measurement: Measurement, name: str) -> tuple[str, str]:
    """Instrument and channel of a group of readings, `set-up.channel`."""
    setup, _, channel = name.rpartition(".")
    return measurement.setups[setup].instrument.name, channel


@dataclasses.dataclass(frozen=True, eq=False)
class HeldOutComparison:
    """Readings of one channel against a fit and against the nominal numbers, SI.

    low, high (n,) ends of the 95 % intervals of the residual
    """

    residual: Array  #: (n,) reading minus the centre of the prediction
    before: Array  #: (n,) reading minus what the nominal numbers give
    low: Array
    high: Array
    draws: Array  #: (m, n) predicted residuals
    noise: Array  #: (m, n) their noise alone

    def take(self, members: slice) -> HeldOutComparison:
        """The comparison of some readings."""
        fields = (field.name for field in dataclasses.fields(self))
        return HeldOutComparison(
            **{name: getattr(self, name)[..., members] for name in fields}
        )

    @property
    def coverage(self) -> float:
        """Share of the readings inside their intervals."""
        return float(self._inside(self.residual))

    @property
    def is_uncovered(self) -> bool:
        """Whether fewer readings are inside than belong there."""
        return self.coverage < float(np.quantile(self._inside(self.draws), RARE_SHARE))

    @property
    def verdict(self) -> HeldOutVerdict:
        """What the readings say of the fit."""
        correction = self.before - self.residual
        gain = _mean_square(self.before) - _mean_square(self.residual)
        by_fit = _mean_square(self.draws + correction) - _mean_square(self.draws)
        by_nominal = _mean_square(self.noise) - _mean_square(self.noise - correction)
        if gain < min(np.quantile(by_fit, RARE_SHARE), 0.0):
            return "contradicts"
        if gain > max(np.quantile(by_nominal, 1.0 - RARE_SHARE), 0.0):
            return "confirms"
        return "contradicts" if self.is_uncovered else "agrees"

    def words(self, setup: str, channel: str, unit: str) -> str:
        """The verdict in words."""
        predicted, after, before = (
            f"{units.number(value, unit):.3g} {unit}"
            for value in map(_rms, (self.draws, self.residual, self.before))
        )
        share = f"{100.0 * self.coverage:.0f} %"
        sentence = (
            f"Held-out readings of {setup} ({len(self.residual)}, {channel}): predicted"
            f" {predicted} rms, seen {after} rms ({before} with the nominal numbers);"
            f" {share} are inside the predicted 95 %"
        )
        return ". ".join([sentence, *self._conclusions()])

    def _conclusions(self) -> list[str]:
        verdict = self.verdict
        if verdict == "contradicts":
            why = "the nominal numbers predict them better"
            if self.is_uncovered:
                why = "fewer are inside than belong there"
            return [f"They contradict the fit: {why}", READ_AGAIN]
        lines = ["They confirm the fit"] if verdict == "confirms" else []
        if self.is_uncovered:
            lines.append(
                "Fewer are inside than belong there: they scatter more than the stated or"
                " estimated noise says"
            )
        return lines

    def _inside(self, residual: Array) -> Array:
        inside = (residual >= self.low) & (residual <= self.high)
        return np.asarray(inside.mean(axis=-1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _mean_square(values: Array) -> Array:
    return np.asarray(np.mean(values**2, axis=-1))


# Steps that predict: accuracy over the workspace, and held-out readings.

MACHINES_AT_ONCE = 200  #: virtual machines that go through a check together
PREDICTIVE_DRAWS = 2000  #: draws used for predictive intervals


def predict_accuracy(state: ScheduledT) -> ScheduledT:
    """Predict the residual accuracy over the workspace, and check it on machines.

    With readings of a virtual machine, which only exercise the plan, the prediction
    rests on the tolerances alone.
    """
    request, machine = state.resolved.prediction, state.measurement.machine
    if request is None:
        return state
    table, command = request.table, request.command
    is_untrusted = False  # readings of a virtual machine rest on no fit
    if isinstance(state, Measured) and state.readings.truth is None:
        sections = state.result
        fitted = trust.section_objections(sections.goodness, sections.estimate)
        is_untrusted = state.fit_is_bad or bool(fitted)
    if is_untrusted:
        reason = (
            "The predicted accuracy is withheld: it would rest on a bad fit"
            if not isinstance(state, Fitted) or state.corrected is None
            else "The fit without effects is bad: no accuracy is predicted from it"
        )
        return state.add_warnings(reason).withhold_section("prediction", reason)
    state.progress.stage("prediction")
    realised = _realised(state, request)
    rng = state.rng(Stream.PREDICT)
    parameter_knowledge = _knowledge(state)
    others = [r for r in get_args(Reference) if r != table.reference]
    by_reference = knowledge.accuracy(
        parameter_knowledge, command, [table.reference, *others], rng
    )
    section = _section(state, parameter_knowledge, by_reference[table.reference])
    section = replace(
        section,
        references={
            reference: spread_records(machine, result.prediction.after)
            for reference, result in by_reference.items()
        },
        tools=_tools(state, request, parameter_knowledge),
    )
    section = add_wanted(section, state.resolved.wanted_accuracy)
    if realised is not None:
        spreads = spread_records(machine, realised)
        after = {n: c.after.rms for n, c in section.components.items()}
        shares = {n: spread.rms / after[n] for n, spread in spreads.items()}
        section = replace(section, realised=spreads, realised_share=shares)
    return state.add_sections(prediction=section)


def _realised(
    state: Scheduled, request: PredictionRequest
) -> Mapping[str, Spread] | None:
    """True pose errors after compensation, by component, of virtual machines.

    None where the study asks for no machine, or is measured.
    """
    count = request.table.virtual_machines
    if not count or (isinstance(state, Fitted) and state.readings.truth is None):
        return None
    measurement, series = state.measurement, state.readings.series
    keep = len(measurement.machine.parameters)
    stages, rng = state.resolved.identification_stages, state.rng(Stream.MACHINES)
    errors = []
    for start in range(0, count, MACHINES_AT_ONCE):
        machines = min(MACHINES_AT_ONCE, count - start)
        noise = measurement.noise(series)
        drawn, noises = [], []
        # machine by machine: how many are drawn together changes no number
        for _ in range(machines):
            drawn.append(draw_parameters(measurement, rng))
            noises.append(noise.draw(rng, (len(noise.sigma),)))
        truth = np.array(drawn)
        y = measurement.readings(series, truth) + np.array(noises)
        fitted = fit_machines(measurement, series, y, stages=stages)
        driven = driven_errors(
            measurement.kinematics,
            request.command,
            truth[:, :keep],
            request.table.reference,
            believed=fitted[:, :keep],
        )
        errors.append(driven)
        state.progress.share((start + machines) / count)
    every = np.concatenate(errors)
    return {
        c.name: Spread.of_errors(every[:, :, k])
        for k, c in enumerate(measurement.machine.components)
    }


def _knowledge(state: Scheduled) -> ParameterKnowledge:
    """What the prediction rests on: real readings, or the plan."""
    series = state.readings.series
    if not isinstance(state, Fitted) or state.readings.truth is not None:
        return knowledge.planned(state.measurement, series)
    draws = _draws(state)
    return knowledge.identified(state.measurement, series, state.estimate, draws)


def _draws(state: Fitted) -> ApproximateDraws:
    """Draws of parameters and noise law: of the posterior, or of its approximation.

    Both follow directions that no reading determines; a covariance does not.
    """
    sampled = state.posterior
    if sampled is not None:
        theta, laws = sampled.pooled, sampled.noise_law
        laws = laws.reshape(len(theta), laws.shape[2])
        return ApproximateDraws(theta, laws, float(np.nanmin(sampled.ess)))
    return posterior.draw_approximation(*state.fit, state.rng(Stream.LAPLACE))


def _section(
    state: Scheduled, parameter_knowledge: ParameterKnowledge, main: Accuracy
) -> PredictionSection:
    """The section with its budget."""
    machine = state.measurement.machine
    planned = parameter_knowledge.mean is None
    budget = parameter_knowledge.model.budget(
        main.maps, estimated=parameter_knowledge.estimated, predicted=main.variance
    )
    mode = "plan" if planned else "identified"
    section = accuracy_section(
        state.measurement.kinematics, main.prediction, mode, budget
    )
    expected = _expected_effects(state, main) if planned else None
    lines = budget_section(machine, main.prediction, budget, expected)
    return replace(section, budget=lines)


def _expected_effects(state: Scheduled, main: Accuracy) -> ExpectedEffects | None:
    """Effects that usually go unmodelled, at the sizes that are expected of them."""
    measurement, request = state.measurement, state.resolved.gap_or_default
    planned = empty_readings(measurement, state.readings.series, request)
    problem = assemble(
        measurement, planned.series, planned.covariates, gravity=request.gravity
    )
    return ExpectedEffects.of(
        problem,
        SessionStates.of(problem),
        BudgetModel.of(measurement, problem.series, measurement.nominal),
        main.maps,
        request.effects,
        main.prediction.reference,
        state.rng(Stream.UNMODELLED),
    )


def _tools(
    state: Scheduled,
    request: PredictionRequest,
    parameter_knowledge: ParameterKnowledge,
) -> list[ToolAccuracy]:
    """Accuracy after compensation at tools of the lengths that the study names."""
    reference = request.table.reference
    machine, unit = state.measurement.machine, units.display("m")
    rng = state.rng(Stream.TOOLS)
    records = []
    for length in request.table.tools:
        tool = np.array([0.0, 0.0, length * MM])
        moved = machine.with_tool(request.command, tool)
        result = knowledge.accuracy(parameter_knowledge, moved, [reference], rng, tool)
        predicted = result[reference].prediction
        spreads = spread_records(machine, predicted.after)
        records.append(ToolAccuracy(units.number(tool[2], unit), unit, spreads))
    return records


def predict_held_out(state: Fitted) -> Fitted:
    """Compare held-out readings with what the fit predicts, over all hypotheses if any."""
    held_out = state.readings.held_out
    if held_out is None:
        return state
    state.progress.stage("held-out readings")
    rng = state.rng(Stream.HELD_OUT)
    drawn = _hypothesis_draws(state, held_out, rng)
    sections = held_out_sections(state.measurement, held_out, drawn, rng)
    return state.add_sections(held_out=sections)


def _hypothesis_draws(
    state: Fitted, held_out: HeldOut, rng: np.random.Generator
) -> list[HypothesisDraws]:
    """Draws by the fit, or by each answer of the diagnosis in its share."""
    if state.mixture is None:
        draws = _draws(state)
        count = min(PREDICTIVE_DRAWS, len(draws.theta))
        rows = rng.choice(len(draws.theta), size=count, replace=False)
        return [
            HypothesisDraws(state.estimate, draws.theta[rows], draws.noise_law[rows])
        ]
    problem = assemble(
        state.measurement,
        held_out.series,
        held_out.covariates,
        state.estimate.theta,
        gravity=state.resolved.gap_or_default.gravity,
    )
    session = session_states(state)
    parts = []
    taken = state.mixture.rows(rng, PREDICTIVE_DRAWS)
    for answer, rows in zip(state.mixture.answers, taken, strict=True):
        changes = None
        if answer.columns is not None:
            coefficients = answer.coefficients[rows]
            changes = coefficients @ answer.columns.changes(problem, session).T
        if len(rows):
            theta, law = answer.theta[rows], answer.noise_law[rows]
            parts.append(HypothesisDraws(answer.estimate, theta, law, changes))
    return parts
