"""The order of work: the only file that knows which stage follows which."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

import oed
from oed import explain, identify, posterior, predict, result, simulate, units
from oed.arrays import Array
from oed.measurement import Measurement, Series
from oed.result import StudyResult
from pkm_studies import claims, files
from pkm_studies import result_folder as stored
from pkm_studies.progress import Progress, Silent
from pkm_studies.resolve import gap as resolve_gap
from pkm_studies.resolve import gap_design as resolve_gap_design
from pkm_studies.resolve.gap_design import GapDesignRequest
from pkm_studies.resolve.resolved import ResolvedStudy, resolve
from pkm_studies.stages import describe, headline
from pkm_studies.stages.design import section as score
from pkm_studies.stages.design import select as choose
from pkm_studies.stages.fit import estimate as fit
from pkm_studies.stages.fit import identifiability as see
from pkm_studies.stages.gap import detectability as gap_before
from pkm_studies.stages.gap import section as gap
from pkm_studies.stages.gap import virtual_readings as gap_virtual
from pkm_studies.stages.plan.earlier import EarlierSession, read_earlier_session
from pkm_studies.stages.plan.plan import compute_plan
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.stages.predict import accuracy as foresee
from pkm_studies.study import Study

if TYPE_CHECKING:
    import pandas as pd

#: independent random streams of the stages: adding draws in one leaves the others as
#: they were
(
    DESIGN,
    TRUTH,
    NOISE,
    SAMPLER,
    PREDICT,
    MACHINES,
    HELD_OUT,
    PLAN,
    CAMPAIGN,
    EFFECTS,
    GAP,
    BEFORE,
) = range(12)


def run(
    study: Study,
    out: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
    report: bool = True,
    readings: Sequence[Path] | None = None,
) -> StudyResult:
    """Everything the study asks for; files in `out`. `readings` replace those the study
    names.

    Raises InputError for what the study asks and cannot be done, IdentificationError
    where a fit fails.
    """
    job = _Job(
        study, out, study.seed if seed is None else seed, progress or Silent(), readings
    )
    return job.run(report=report)


def identify_readings(
    study: Study,
    readings: Sequence[Path],
    out: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """The study's stages with readings from files."""
    return run(study, out, seed=seed, progress=progress, readings=list(readings))


def diagnose_readings(
    study: Study,
    readings: Sequence[Path] | None,
    out: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """What calibration leaves of the readings (the study's own where None), and which
    effects cause it.

    Raises InputError where there are no readings.
    """
    job = _Job(
        study, out, study.seed if seed is None else seed, progress or Silent(), readings
    )
    return job.diagnose_only()


def plan_stages(
    study: Study,
    out: Path,
    *,
    after: Path | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """The study's plan alone: nothing is read or fitted. `after`: a folder with what
    was identified already.

    Raises InputError where the study lists no measurement, or the time pays for none.
    """
    job = _Job(
        study, out, study.seed if seed is None else seed, progress or Silent(), []
    )
    return job.plan_only(after)


def simulate_readings(
    study: Study, out: Path, *, seed: int | None = None
) -> tuple[Path, Path]:
    """Readings of the study's virtual machine as CSV in `out`, its truth in `out` with
    the suffix .truth.json.
    """
    from oed import dataset

    job = _Job(study, out.parent, study.seed if seed is None else seed, Silent(), [])
    chosen = job.design()
    job.plan(None)
    series = job.planned(chosen)
    series, truth, y, covariates, acting = job.virtual(series)
    if covariates is not None:
        covariates = covariates.drop(columns=["setup", "run", "order"])
    made = dataset.from_series(series, y, job.measurement, covariates)
    files.out_folder(out.parent)
    dataset.save(out, made)
    table: dict[str, Any] = {
        p.name: {"value": float(v), "unit": p.unit}
        for p, v in zip(job.measurement.parameters, truth, strict=True)
    }
    if acting:
        table["effects"] = acting
    beside = out.with_name(
        out.name.removesuffix(".readings.csv").removesuffix(".csv") + ".truth.json"
    )
    return out, files.write_whole(
        beside, msgspec.json.format(msgspec.json.encode(table), indent=1)
    )


class _Job:
    """One run: the study's objects, and the sections as they come."""

    def __init__(
        self,
        study: Study,
        out: Path,
        seed: int,
        progress: Progress,
        readings: Sequence[Path] | None,
    ) -> None:
        self.study, self.out, self.seed, self.progress = study, out, seed, progress
        self.started = time.perf_counter()
        progress.stage("set-up")
        self.resolved: ResolvedStudy = resolve(study, readings=readings)
        self.measurement: Measurement = self.resolved.measurement
        self.sections: dict[str, Any] = {}
        self.planned_series: tuple[Series, ...] = ()
        self.made: PlanOutcome | None = None
        self.covariates: pd.DataFrame | None = None  # of the readings that are fitted
        self.replaced = bool(readings)
        self.warnings = list(self.resolved.warnings)

    def rng(self, stream: int) -> np.random.Generator:
        """Random numbers of one stage."""
        return np.random.default_rng([self.seed, stream])

    def run(self, *, report: bool) -> StudyResult:
        files.out_folder(self.out)
        chosen = self.design()
        if not self.replaced:
            self.plan(None)
        series, y, truth, held = self._readings(chosen)
        seen = self._identifiability(chosen, series)
        self._design_sections(chosen, seen)
        self._gap_before(series)
        estimate, drawn = self._fit(series, y, truth)
        self._gap(series, y, estimate, self.resolved.gap)
        # a virtual machine only exercises the plan: what is told is the accuracy
        # foreseen before any reading
        self._prediction(series, None if truth is not None else estimate)
        if held is not None and drawn is not None:
            self.progress.stage("held-out readings")
            self.sections["held_out"] = foresee.held_out(
                self.measurement, *held, drawn, self.rng(HELD_OUT)
            )
        if self.made is None:
            self.sections["plan"] = choose.single_stage_plan(
                self.resolved, seen, headline.predicted(self.sections)
            )
        self.sections["drawing"] = describe.drawing(self.measurement, series)
        return self._finish(chosen, report=report)

    def plan_only(self, after: Path | None) -> StudyResult:
        """The plan, its readings' identifiability and drawing, and the claims about
        them.
        """
        place = self.study.place.key("plan").key("measurement")
        if self.resolved.plan is None:
            raise place.error(
                "the study lists no measurement to plan with",
                "add [[plan.measurement]] tables",
            )
        files.out_folder(self.out)
        known = (
            None
            if after is None
            else read_earlier_session(self.resolved, after, stored.load_result(after))
        )
        if known is not None:
            self.resolved = known.resolved
        self.plan(known)
        assert self.made is not None
        seen = self._identifiability(None, self.made.series)
        self.measurement = seen.measurement
        self.sections["drawing"] = describe.drawing(self.measurement, self.made.series)
        cause = self.resolved.gap_design
        if cause is not None and cause.follows:
            self._gap_before(self.made.series)
        return self._finish(
            None, report=False, only=("plan", "identifiability", "gap_before")
        )

    def diagnose_only(self) -> StudyResult:
        """Fit and diagnosis, and the claims about them; design, posterior and
        prediction are left out.
        """
        data, said = self.resolved.dataset, self.study.readings
        if data is None and said is None:
            raise self.study.place.key("readings").error(
                "there are no readings to diagnose", "give --readings FILE.csv"
            )
        files.out_folder(self.out)
        chosen = self.design() if data is None else None
        if data is None:
            self.plan(None)
        series, y, truth, _ = self._readings(chosen)
        self._identifiability(None, series)
        estimate, _ = self._fit(series, y, truth, sample=False)
        asked = self.resolved.gap or resolve_gap.gap_request(
            self.study, self.resolved.machine, always=True
        )
        self._gap(series, y, estimate, asked)
        self.sections["drawing"] = describe.drawing(self.measurement, series)
        return self._finish(
            None,
            report=True,
            only=("gap", "estimate", "identifiability", "identifiability_of"),
        )

    # -- stages ------------------------------------------------------------------------

    def design(self) -> choose.ChosenDesign | None:
        """The plan, where the study asks for one; from here on the measurement has the
        set-ups that it uses.
        """
        self.progress.stage("design")
        chosen = choose.select_design(self.resolved, self.rng(DESIGN))
        if chosen is not None:
            self.planned_series, self.measurement = chosen.scheduled, chosen.measurement
            self._note_moved(chosen)
        return chosen

    def plan(self, known: EarlierSession | None) -> None:
        """The plan of stages, where the study lists measurements; without a design, its
        readings are those planned.
        """
        if self.resolved.plan is None:
            return
        self.progress.stage("plan")
        machines = self.rng(CAMPAIGN)
        self.made = compute_plan(
            self.resolved, [self.seed, PLAN], machines, self.progress, known
        )
        assert self.made is not None
        self.sections["plan"] = self.made.section
        if not self.resolved.candidates or known is not None:
            self.planned_series = tuple(
                s for stage in self.made.scheduled for s in stage
            )
            if self.resolved.dataset is None:
                self.measurement = self.made.measurement

    def _note_moved(self, chosen: choose.ChosenDesign) -> None:
        for name, values in (chosen.polished.setups if chosen.polished else {}).items():
            told = ", ".join(f"{k} = {v:.6g}" for k, v in values.items())
            self.warnings.append(
                f"set-up {name} was moved by polishing: write {told} there before its"
                " readings are fitted"
            )

    def planned(self, chosen: choose.ChosenDesign | None) -> tuple[Series, ...]:
        """The chosen plan, or the first given one. Raises InputError where there is
        none.
        """
        if chosen is not None:
            return chosen.series
        if self.made is not None:
            return self.made.series
        if self.resolved.reference_plans:
            return self.resolved.reference_plans[0].series
        raise self.study.place.key("design").error(
            "the study has neither readings nor a plan",
            "add [[design.candidates]], [[design.reference]], [[plan.measurement]] or"
            " [readings]",
        )

    def virtual(
        self, series: Sequence[Series]
    ) -> tuple[
        tuple[Series, ...], Array, Array, pd.DataFrame | None, list[dict[str, Any]]
    ]:
        """Series, true parameters, readings, covariates and acting effects of the
        study's virtual machine.
        """
        said = self.study.readings
        drawn = (
            said is None or said.draw or not self.resolved.true_parameters
        )  # a nominal machine would tell nothing
        truth = (
            simulate.draw(self.measurement, self.rng(TRUTH))
            if drawn
            else self.measurement.nominal
        )
        for k, name in enumerate(self.measurement.names):
            truth[k] = self.resolved.true_parameters.get(name, truth[k])
        asked = self.resolved.gap
        if asked is None:
            return (
                tuple(series),
                truth,
                simulate.read(self.measurement, series, truth, self.rng(NOISE)),
                None,
                [],
            )
        planned = gap_virtual.laid_out(self.measurement, series, asked)
        exact, told = gap_virtual.readings(
            self.measurement, planned, truth, asked, self.rng(EFFECTS)
        )
        y = exact + self.measurement.noise(planned.series).draw(
            self.rng(NOISE), exact.shape
        )
        return planned.series, truth, y, planned.covariates, told

    def _readings(
        self, chosen: choose.ChosenDesign | None
    ) -> tuple[
        tuple[Series, ...],
        Array | None,
        Array | None,
        tuple[Sequence[Series], Array] | None,
    ]:
        """Series to work on, what they read, the truth of a virtual machine, and
        readings kept out.
        """
        data = self.resolved.dataset
        if data is not None:
            kept_out = self.resolved.held_out_setups
            fitted = self.resolved.fitted_setups or tuple(
                n for n in data.setups if n not in kept_out
            )
            mine, rest = data.take(fitted), data.take(kept_out)
            self._note_dropped(data.dropped)
            self.covariates = mine.covariates
            return (
                mine.series,
                mine.y,
                None,
                (rest.series, rest.y) if kept_out else None,
            )
        series = self.planned(chosen)
        if self.study.readings is None:
            return series, None, None, None
        series, truth, y, self.covariates, _ = self.virtual(series)
        return series, y, truth, None

    def _note_dropped(self, count: int) -> None:
        if count:
            self.warnings.append(f"{count} rows without a reading were left out")

    def _identifiability(
        self, chosen: choose.ChosenDesign | None, series: Sequence[Series]
    ) -> explain.Seen:
        self.progress.stage("identifiability")
        scaling = self.study.design.scaling if self.study.design else "length"
        plans = {
            p.name: (self.resolved.measurement_with(p.setups), p.series)
            for p in self.resolved.reference_plans
        }
        seen = explain.look(self.measurement, series, scaling)
        used = {s.setup for s in series}
        others = {n: r for n, r in plans.items() if not {s.setup for s in r[1]} <= used}
        self.sections["identifiability"] = see.section(seen, scaling, others)
        self.sections["identifiability_of"] = see.variants(
            self.measurement, series, plans, scaling
        )
        self.sections["kappa_maps"] = [
            choose.kappa_map(c, scaling) for c in self.resolved.kappa_circles
        ]
        return seen

    def _design_sections(
        self, chosen: choose.ChosenDesign | None, seen: explain.Seen
    ) -> None:
        if chosen is not None:
            self.sections["design"] = score.design_section(self.resolved, chosen, seen)

    def _fit(
        self,
        series: Sequence[Series],
        y: Array | None,
        truth: Array | None,
        *,
        sample: bool = True,
    ) -> tuple[identify.Estimate | None, posterior.Posterior | None]:
        if y is None:
            return None, None
        self.progress.stage("identification")
        found = identify.identify(
            self.measurement,
            series,
            y,
            stages=self.resolved.identification_stages,
            estimate_noise=self.study.noise.estimate,
            max_iterations=self.study.identify.max_iterations,
        )
        self.sections["estimate"] = fit.estimate_section(
            self.measurement, series, found, truth
        )
        self.warnings += self.sections["estimate"].warnings
        if not (sample and self.study.posterior.enabled):
            return found, None
        posterior.prepare()
        self.progress.stage("posterior")
        asked = self.study.posterior
        drawn = posterior.sample(
            self.measurement,
            series,
            y,
            found,
            self.rng(SAMPLER),
            walkers=asked.walkers,
            ess=float(asked.ess),
            max_steps=asked.steps,
            progress=self.progress.share,
        )
        self.sections["posterior"] = fit.posterior_section(
            self.measurement, found, drawn, self.study.report.corner
        )
        self._judge(drawn)
        posterior.save(
            drawn,
            self.out / "posterior.nc",
            {"study": self.study.name, "units": "SI", "seed": str(self.seed)},
        )
        return found, drawn

    def _gap_before(self, series: Sequence[Series]) -> None:
        """What the readings could find, and the runs that [gap.design] chooses, where
        the study has a [gap].
        """
        asked, wanted = self.resolved.gap, self.resolved.gap_design
        if asked is None:
            return
        self.progress.stage("what the readings could find")
        rows = self.covariates
        if rows is None:
            planned = gap_virtual.laid_out(self.measurement, series, asked)
            series, rows = planned.series, planned.covariates
        if wanted is not None and wanted.follows:
            wanted = self._following(wanted)
        designed = (
            None
            if wanted is None
            else (
                self.resolved.measurement_with({r.setup for r in wanted.runs}),
                wanted,
            )
        )
        made = gap_before.foresee(
            self.measurement,
            series,
            rows,
            asked.effects,
            asked.gravity,
            self.rng(BEFORE),
            designed,
        )
        self.sections["gap_before"] = made.section
        if made.poses_csv is not None:
            files.write_whole(self.out / "gap_poses.csv", made.poses_csv)

    def _following(self, wanted: GapDesignRequest) -> GapDesignRequest | None:
        """[gap.design] with the plan's readings kept; None where there is no plan,
        since readings were given.
        """
        if self.made is None or self.resolved.plan is None:
            return None
        left = self.resolved.plan.budget - units.factor("min") * self.made.section.cost
        used = {s.setup for s in self.made.series} | {r.setup for r in wanted.runs}
        return resolve_gap_design.following(
            wanted, self.made.series, left, self.resolved.measurement_with(used)
        )

    def _gap(
        self,
        series: Sequence[Series],
        y: Array | None,
        estimate: identify.Estimate | None,
        asked: resolve_gap.GapRequest | None,
    ) -> None:
        """The diagnosis of what the fit leaves, where the study asks for one and there
        are readings.
        """
        if asked is None or y is None or estimate is None:
            return
        self.progress.stage("diagnosis")
        rows = self.covariates
        if rows is None:
            rows = gap_virtual.laid_out(self.measurement, series, asked).covariates
        found = gap.diagnose(
            self.measurement, series, y, rows, estimate.theta, asked, self.rng(GAP)
        )
        self.sections["gap"] = gap.section(found, asked.effects)

    def _judge(self, drawn: posterior.Posterior) -> None:
        least = float(np.nanmin(drawn.ess))
        if least < self.study.posterior.ess:
            self.warnings.append(
                f"the posterior has an effective sample size of {least:.0f}, short of"
                f" {self.study.posterior.ess}; raise [posterior] steps"
            )

    def _prediction(
        self, series: Sequence[Series], known: identify.Estimate | None
    ) -> None:
        said, command = self.study.prediction, self.resolved.prediction_commands
        if said is None or command is None:
            return
        self.progress.stage("prediction")
        reference: predict.Reference = said.reference
        realised = foresee.virtual_machines(
            self.measurement,
            series,
            command,
            reference,
            said.virtual_machines,
            self.rng(MACHINES),
            self.resolved.identification_stages,
            self.progress,
        )
        foreseen = foresee.section(
            self.measurement,
            series,
            command,
            reference,
            self.rng(PREDICT),
            known,
            realised,
        )
        shares = {
            n: s.rms / foreseen.components[n].after.rms
            for n, s in (foreseen.realised or {}).items()
        }
        self.sections["prediction"] = msgspec.structs.replace(
            foreseen, realised_share=shares
        )

    # -- results -----------------------------------------------------------------------

    def _finish(
        self,
        chosen: choose.ChosenDesign | None,
        *,
        report: bool,
        only: tuple[str, ...] | None = None,
    ) -> StudyResult:
        """The result, written. `only`: sections of which claims are looked at, by
        default all.
        """
        study = self.study
        made = StudyResult(
            schema=result.SCHEMA,
            version=oed.__version__,
            study=study.name,
            title=study.title or study.name,
            question=study.question,
            seed=self.seed,
            seconds=0.0,
            machine=describe.machine(self.resolved.machine),
            setups=[
                describe.setup(self.resolved.machine, s)
                for s in self.measurement.setups.values()
            ],
            study_text=study.text,
            versions=describe.versions(),
            headline=headline.sentences(self.sections),
            warnings=list(dict.fromkeys(self.warnings)),
            **self.sections,
        )
        found = claims.check_claims(study, msgspec.to_builtins(made), only)
        seconds = round(time.perf_counter() - self.started, 3)
        made = msgspec.structs.replace(made, claims=found, seconds=seconds)
        stored.write(
            self.out,
            made,
            self.planned_series,
            self.measurement,
            self.made,
            sheet=study.report.pdf,
        )
        if report and (study.report.html or study.report.pdf):
            self.progress.stage("report")
            stored.write_report(self.out, html=study.report.html, pdf=study.report.pdf)
        return made
