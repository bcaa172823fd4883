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
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__version__ = "0.3.0"

#: names of the mathematics and where they are, imported when first used: the command
#: starts quickly
_KERNEL = {
    "StudyResult": "oed.result",
    "Machine": "oed.model",
    "Parameter": "oed.model",
    "Coordinate": "oed.model",
    "Component": "oed.model",
    "PassiveJoint": "oed.model",
    "PointGroup": "oed.model",
    "Instrument": "oed.instrument",
    "Channel": "oed.instrument",
    "Setting": "oed.instrument",
    "mount": "oed.instrument",
    "Effect": "oed.effect_model",
    "Column": "oed.effect_model",
    "Measurement": "oed.measurement",
}
#: names that need study files: the package which has them offers each as an entry point
_STUDIES = (
    "load_study",
    "build_study",
    "choose_design",
    "plan",
    "read_readings",
    "simulate",
    "identify",
    "sample",
    "predict",
    "diagnose",
    "next_reading",
    "verify",
    "run",
    "write_report",
    "write_compensation",
    "Study",
    "InputError",
)
ENTRY_POINTS = "oed.names"

__all__ = ["__version__", *_STUDIES, *_KERNEL]


def __getattr__(name: str) -> Any:
    if name in _KERNEL:
        value = getattr(importlib.import_module(_KERNEL[name]), name)
    elif name in _STUDIES:
        value = _entry_point(name).load()
    else:
        raise AttributeError(f"module 'oed' has no attribute {name!r}")
    globals()[name] = value
    return value


def _entry_point(name: str) -> EntryPoint:
    from importlib.metadata import entry_points

    installed = entry_points(group=ENTRY_POINTS, name=name)
    if not installed:
        raise AttributeError(
            f"oed.{name} needs study files, and no installed package offers them."
            " Install pkm-oed again: pip install pkm-oed"
        )
    return next(iter(installed))


def __dir__() -> list[str]:
    return sorted(__all__)
