"""Results as a notebook shows them: a table, pandas, xarray, and the kernel's objects."""

from __future__ import annotations

import dataclasses
import html
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from oed import result
from pkm_studies.stages import Fitted, Measured, Scheduled, written

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

    from oed.base import Array
    from oed.estimation import Estimate
    from oed.posterior import Posterior

StageT = TypeVar("StageT", bound=Scheduled)
SectionT = TypeVar("SectionT")

ROWS_SHOWN = 30  #: rows that a notebook shows of a table


@dataclasses.dataclass(frozen=True)
class View(Generic[StageT]):
    """A step's outcome, with the state of the run that led to it."""

    state: StageT  #: of the run: kernel objects, random streams, sections so far

    def __post_init__(self) -> None:
        """Raises WithheldError where the step left out what the view shows."""
        str(self.title)

    @property
    def title(self) -> str:
        """What is shown, in one line."""
        raise NotImplementedError

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences that a user must know."""
        return self.state.warnings

    def to_pandas(self) -> pd.DataFrame:
        """The outcome as a table; units stand in the column names."""
        raise NotImplementedError

    def to_xarray(self) -> xr.Dataset:
        """The outcome as a labelled dataset."""
        import xarray as xr

        return xr.Dataset.from_dataframe(self.to_pandas())

    def __repr__(self) -> str:
        return f"{self.title}\n{self.to_pandas().head(ROWS_SHOWN)}"

    def _repr_html_(self) -> str:
        table = self.to_pandas()
        shown = table.head(ROWS_SHOWN).to_html(float_format=lambda v: f"{v:.4g}")
        rest = len(table) - ROWS_SHOWN
        more = f"<p>{rest} further rows</p>" if rest > 0 else ""
        lines = "".join(f"<li>{html.escape(text)}</li>" for text in self.warnings)
        warnings = f"<ul>{lines}</ul>" if lines else ""
        return f"<p><b>{html.escape(self.title)}</b></p>{warnings}{shown}{more}"


class SectionView(View[StageT], Generic[StageT, SectionT]):
    """The outcome as a section of result.json, which has a figure."""

    part: ClassVar[str]  #: name of the section
    figure: ClassVar[str]  #: what draws it, see `axes`

    @property
    def section(self) -> SectionT:
        """The section of the result."""
        section: SectionT | None = getattr(self.state.result, self.part)
        return written(section, self.part, self.state.withheld)

    @property
    def _drawn(self) -> tuple[Any, ...]:
        return (self.section,)

    def plot(self, axes: Axes | None = None) -> Axes:
        """The outcome as a figure, on a matplotlib axis."""
        from pkm_studies.notebook import axes as figures

        axes = axes or figures.new_axes()
        getattr(figures, self.figure)(*self._drawn, axes)
        return axes


class DesignView(SectionView[Scheduled, result.DesignSection]):
    """The chosen readings: `section` has value, bound, efficiency and poses."""

    part: ClassVar[str] = "design"
    figure: ClassVar[str] = "design"

    @property
    def title(self) -> str:
        design = self.section
        text = f"{design.n} of {design.candidates} readings by {design.criterion}"
        if design.efficiency is None:
            return text
        return f"{text}; efficiency at least {design.efficiency:.1%}"

    def to_pandas(self) -> pd.DataFrame:
        import pandas as pd

        rows: list[dict[str, Any]] = []
        for pose in self.section.poses:
            location = {"setup": pose.setup, "run": pose.run, "order": pose.order}
            rows.append({**location, **pose.command, **pose.reading})
        return pd.DataFrame(rows)


class PlanView(SectionView[Scheduled, result.PlanSection]):
    """The plan of stages: which measurement first, which next."""

    part: ClassVar[str] = "plan"
    figure: ClassVar[str] = "stages"

    @property
    def title(self) -> str:
        return f"{len(self.section.stages)} stages in {self.section.cost:.0f} min"

    def to_pandas(self) -> pd.DataFrame:
        import pandas as pd

        rows: list[dict[str, Any]] = []
        for stage in self.section.stages:
            summary = {
                "measurement": stage.measurement,
                "readings": stage.readings,
                "identifies": stage.identifies,
                "cost_min": stage.cost,
            }
            rows.append({**summary, **stage.predicted})
        return pd.DataFrame(rows)


class ReadingsView(View[Measured]):
    """Readings with their poses and covariates, ready to be fitted."""

    @property
    def title(self) -> str:
        readings = self.state.readings
        origin = "recorded" if readings.truth is None else "of a virtual machine"
        return f"{sum(len(series) for series in readings.series)} readings, {origin}"

    def to_pandas(self) -> pd.DataFrame:
        import io

        import pandas as pd

        from oed import dataset

        readings = self.state.readings
        covariates = readings.covariates
        if covariates is not None:
            covariates = covariates.drop(columns=["setup", "run", "order"])
        data = dataset.from_series(
            readings.series, readings.y, self.state.measurement, covariates
        )
        return pd.read_csv(io.StringIO(dataset.to_csv(data)))


class _ParametersView(SectionView[Fitted, SectionT]):
    """Parameters as arrays, SI, in the order of `names`."""

    @property
    def _parameters_si(self) -> Estimate | Posterior:
        raise NotImplementedError

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the n parameters."""
        return tuple(self.state.measurement.names)

    @property
    def theta(self) -> Array:
        """Most probable parameters, or the mean of the draws (n,), SI."""
        return self._parameters_si.theta

    @property
    def sd(self) -> Array:
        """Standard deviations (n,), SI."""
        return self._parameters_si.sd

    @property
    def covariance(self) -> Array:
        """Covariance (n, n), SI."""
        return self._parameters_si.covariance


class EstimateView(_ParametersView[result.EstimateSection]):
    """The identified parameters, each with its standard deviation."""

    part: ClassVar[str] = "estimate"
    figure: ClassVar[str] = "residuals"

    @property
    def _parameters_si(self) -> Estimate:
        return self.state.estimate

    @property
    def title(self) -> str:
        rms = self.section.rms_after
        residual = ", ".join(
            f"{name} {value:.3g} {self.section.units[name]}"
            for name, value in rms.items()
        )
        aside = self.state.goodness.fit_words
        return (
            f"Fit of {self.section.readings} readings{aside}: rms residual {residual}"
        )

    def to_pandas(self) -> pd.DataFrame:
        import msgspec
        import pandas as pd

        parameters = msgspec.to_builtins(self.section.parameters)
        return pd.DataFrame.from_dict(parameters, orient="index")


class PosteriorView(_ParametersView[result.PosteriorSection]):
    """Draws of the parameters, and their summary."""

    part: ClassVar[str] = "posterior"
    figure: ClassVar[str] = "posterior"

    @property
    def _parameters_si(self) -> Posterior:
        return written(self.state.posterior, "posterior", self.state.withheld)

    @property
    def title(self) -> str:
        return f"Posterior of {self.section.draws} draws"

    def to_pandas(self) -> pd.DataFrame:
        import msgspec
        import pandas as pd

        marginals = msgspec.to_builtins(self.section.marginals)
        return pd.DataFrame.from_dict(marginals, orient="index")

    def to_xarray(self) -> xr.Dataset:
        """The draws themselves, SI: one variable `theta` over chain, draw, parameter."""
        import xarray as xr

        posterior = self._parameters_si
        dims = ("chain", "draw", "parameter")
        names = list(posterior.names)
        return xr.Dataset({"theta": (dims, posterior.draws)}, {"parameter": names})

    def to_arviz(self) -> xr.DataTree:
        """The draws as ArviZ reads them: groups `posterior` and `sample_stats`, SI."""
        from oed.posterior import to_arviz

        return to_arviz(self._parameters_si)

    @property
    def _drawn(self) -> tuple[Any, ...]:
        return self.section, self.state.estimate_section.parameters


class AccuracyView(SectionView[Scheduled, result.PredictionSection]):
    """The residual accuracy over the workspace, before and after compensation."""

    part: ClassVar[str] = "prediction"
    figure: ClassVar[str] = "accuracy"

    @property
    def title(self) -> str:
        return (
            f"Predicted accuracy over {self.section.poses} poses"
            f" ({self.section.reference})"
        )

    def to_pandas(self) -> pd.DataFrame:
        import pandas as pd

        rows = {}
        for name, component in self.section.components.items():
            rows[name] = {
                "unit": self.section.unit[name],
                "compensatable": component.compensatable,
                "before_rms": component.before.rms,
                "after_rms": component.after.rms,
                "after_p95": component.after.p95,
                "after_max": component.after.max,
            }
        return pd.DataFrame.from_dict(rows, orient="index")


class DiagnosisView(SectionView[Fitted, result.GapSection]):
    """What calibration leaves: causes with probabilities, places, closure."""

    part: ClassVar[str] = "gap"
    figure: ClassVar[str] = "causes"

    @property
    def corrected(self) -> result.CorrectedSection | None:
        """Parameters and likely effects, estimated together; None without such effects."""
        return self.state.result.corrected

    @property
    def title(self) -> str:
        section = self.section
        if not section.words:
            return section.verdict
        # the verdict, a sentence on the size of each cause, and the place
        return " ".join(section.words[: 2 + len(section.selected)])

    def to_pandas(self) -> pd.DataFrame:
        import pandas as pd

        rows = [
            {
                "effects": " + ".join(answer.effects) or "none",
                "probability": answer.probability,
                "unseen": answer.unseen,
            }
            for answer in self.section.answers
        ]
        return pd.DataFrame(rows)


@dataclasses.dataclass(frozen=True)
class Said:
    """What a command of the machine says, and what it is made of."""

    sentences: tuple[str, ...]  #: as the command prints them
    outcome: Any  #: the advice, the planned test, or its verdict

    def __repr__(self) -> str:
        return "\n".join(self.sentences)
