"""Tables of readings, identification, posterior and prediction."""

from typing import Annotated, Any, Literal

import msgspec

from pkm_studies.tables.base import Count, Positive, StudyTable
from pkm_studies.tables.grids import Axis


class ReadingsTable(StudyTable, frozen=True, kw_only=True):
    """[readings]: from files, from a named collection of data, or simulated.

    files     readings files, relative to the study
    source    name of a collection, an entry point `pkm_oed.sources`: such as jugglebot
    path      folder of the collection, relative to the study
    simulate  whether a virtual machine gives the readings
    draw      whether its parameters are drawn from the tolerances
    truth     parameters of the virtual machine, as in `dq1_mm = 1.5`; a set-up's
              unknowns in a table with the set-up's name
    fit       set-ups whose readings are fitted; by default all but those of `predict`
    predict   set-ups whose readings are predicted, not fitted
    """

    files: list[str] = []
    source: str | None = None
    path: str | None = None
    simulate: bool = False
    draw: bool = False
    truth: dict[str, float | dict[str, float]] = {}
    fit: list[str] | None = None
    predict: list[str] = []


class IdentifyTable(StudyTable, frozen=True, kw_only=True):
    """[identify]: how the parameters are fitted.

    stages          patterns of the parameters freed in turn; by default all at once
    max_iterations  of each stage
    effects         effects beside the geometry that the readings are asked about, by name,
                    or "catalogue": all that the machine can have, the default for readings
                    of a machine. Parameters, accuracy and what a controller is sent are
                    those over all hypotheses; "none": what is said holds for the geometry
                    alone, the default for readings of a virtual machine
    """

    stages: Annotated[list[list[str]], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [["*"]]
    )
    max_iterations: Count = 50
    effects: Literal["none", "catalogue"] | list[str] | None = None

    @property
    def fitted_effects(self) -> str | list[str]:
        """Effects that the fit allows: "none", "catalogue" or names."""
        return "none" if self.effects is None else self.effects


#: what predicted errors refer to
PredictionReference = Literal["home", "absolute", "best_fit"]


class PosteriorTable(StudyTable, frozen=True, kw_only=True):
    """[posterior]: how to sample, and how long.

    enabled  whether to sample
    sampler  "auto": independent draws by importance sampling where the tail of their
             weights allows it, else emcee, started from them; "emcee": always emcee
    ess      effective sample size of each parameter at which sampling stops
    draws    most draws in posterior.nc; by default as many as are worth `ess`, of emcee
             four times `ess`
    walkers  of emcee: number of chains, in up to four independent ensembles
    steps    of emcee: most steps of each chain
    thin     of emcee: each so many-th step is a draw, or fewer where `draws` asks for it
    """

    enabled: bool = True
    sampler: Literal["auto", "emcee"] = "auto"
    walkers: Annotated[int, msgspec.Meta(ge=4, le=100_000)] | None = None
    steps: Count = 20_000
    ess: Count = 1000
    draws: Count | None = None
    thin: Count = 1

    @property
    def sampler_options(self) -> dict[str, Any]:
        """Options of the sampler."""
        return {
            "sampler": self.sampler,
            "walkers": self.walkers,
            "ess": float(self.ess),
            "max_steps": self.steps,
            "max_draws": self.draws,
            "thin": self.thin,
        }


class ForecastTable(StudyTable, frozen=True, kw_only=True):
    """[forecast]: forecast compensation over the workspace of [prediction].

    expected     rms error that calibration leaves, by component, `{ y_um = 60 }`
    sigma        standard deviation of one measured error, likewise; that of the set-up's
                 channel of this name by default
    wanted       rms error that may be left, likewise; nodes are added until it is reached
    nodes        number of nodes, at most
    setup        set-up that measures: its times, its noise; the first one by default
    readings     file of measured nodes
    check        file of nodes that are not fitted, and show what is left
    compensated  whether the nodes are measured with the estimate in the controller; else
                 with the nominal numbers. [machine] controller says what it holds instead
    commands     largest number of commands of the controller's table
    """

    expected: dict[str, Positive]
    sigma: dict[str, Positive] = {}
    wanted: dict[str, Positive] = {}
    nodes: Annotated[int, msgspec.Meta(ge=3, le=1000)] = 40
    setup: str = ""
    readings: str = ""
    check: str = ""
    compensated: bool = True
    commands: Annotated[int, msgspec.Meta(ge=2, le=1_000_000)] = 5000


class PredictionTable(StudyTable, frozen=True, kw_only=True):
    """[prediction]: residual accuracy over a grid of the workspace.

    reference         what errors refer to: home, the base frame ("absolute"), or the best
                      alignment ("best_fit")
    virtual_machines  number of machines that check the prediction
    tools_mm          lengths of further tools at which accuracy is predicted; the grid
                      moves with the tool point
    wanted            rms error to reach, by component, `{ z_um = 30, theta_arcsec = 2 }`;
                      reported beside the predicted one. A claim of [expect] tests it
    states            what the machine is used at, by column of the readings file:
                      `{ payload_N = [0, 500], temp_frame_C = [18, 26] }`. Effects of
                      [identify] act there; anything else is as in the session. By
                      default both directions, all payloads, and each leg and the frame
                      cold and warm, as far as readings recorded them
    further           coordinates of the grid, as in [[design.candidates]]
    """

    free_keys = "coordinates"
    reference: PredictionReference = "home"
    virtual_machines: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0
    tools: list[float] = msgspec.field(name="tools_mm", default_factory=list)
    wanted: dict[str, Positive] = {}
    states: dict[str, list[float] | float] = {}
    coordinates: dict[str, Axis] = {}
