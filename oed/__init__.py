"""Optimal experiment design and uncertainty for calibrating parallel kinematic machines.

`import oed` offers what a notebook needs, from a study to its results:

    study = oed.load_study("a3_ball_bar")
    design = oed.choose_design(study)
    readings = oed.simulate(design)
    estimate = oed.identify(readings)
    accuracy = oed.predict(estimate)

The mathematics lies in the submodules, machines and instruments in `pkm_models`, study
files and the command in `pkm_studies`, reports in `pkm_reports`.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

#: public names and where they live. They are imported when first used: the command
#: starts quickly, and this package stays below the others.
_HOMES = {
    "load_study": "pkm_studies.notebook.notebook",
    "build_study": "pkm_studies.notebook.notebook",
    "choose_design": "pkm_studies.notebook.notebook",
    "plan": "pkm_studies.notebook.notebook",
    "read_readings": "pkm_studies.notebook.notebook",
    "simulate": "pkm_studies.notebook.notebook",
    "identify": "pkm_studies.notebook.notebook",
    "sample": "pkm_studies.notebook.notebook",
    "predict": "pkm_studies.notebook.notebook",
    "diagnose": "pkm_studies.notebook.notebook",
    "run": "pkm_studies.notebook.notebook",
    "write_report": "pkm_studies.notebook.notebook",
    "write_compensation": "pkm_studies.notebook.notebook",
    "Study": "pkm_studies.study",
    "InputError": "pkm_studies.base.errors",
    "StudyResult": "oed.result",
    "Machine": "oed.model.machine",
    "Parameter": "oed.model.machine",
    "Coordinate": "oed.model.machine",
    "Component": "oed.model.machine",
    "PointGroup": "oed.model.machine",
    "Instrument": "oed.model.instrument",
    "Channel": "oed.model.instrument",
    "Setting": "oed.model.instrument",
    "mount": "oed.model.instrument",
    "Effect": "oed.model.effect",
    "Column": "oed.model.effect",
    "Measurement": "oed.measurement.measurement",
}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'oed' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
