"""A made-up but realistic result of a study, as in result.json: an A3 head.

24 parameters (18 of the machine, 3 for each of two cups), 30 poses in two set-ups, 3
lost directions.
"""

from __future__ import annotations

import html
import math
import re
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture_design
import report_fixture_fit
import report_fixture_machine
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import Axes3D
from sketches import Sketches

from oed.result import StudyResult
from pkm_reports.page import document, render_html

TEXT = """schema = 1
title = "A3 head with a double ball bar"  # <tags> & $pecial \\ characters

[machine]
name = "a3_head"

[[setup]]
name = "short tool"
instrument = "ball_bar"
length_mm = 300
sigma_um = 0.5

[design]
criterion = "D"
readings = 30

[expect]
rank = 21
"""
sketched = Sketches()
#: sections that a result may lack, and lists that may be empty
SECTIONS = (
    "identifiability",
    "design",
    "plan",
    "estimate",
    "posterior",
    "prediction",
    "drawing",
)
LISTS = ("kappa_maps", "held_out", "warnings", "claims", "setups", "headline")
#: condition numbers of a taught cup over the points on a circle
KAPPA = [3908, 5210, 4587, 3748, 4530, 4300, 4184, 4300, 4439, 4400, 4420, 4410, 4420]


def result_of(raw: dict[str, Any]) -> StudyResult:
    """A result as it comes back from result.json."""
    return msgspec.json.decode(msgspec.json.encode(raw), type=StudyResult)


def shown_text(result: StudyResult) -> str:
    """Text of the page of a result, without tags, its no-break spaces as spaces.

    Its figures are sketched.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(document, "drawn_image", sketched)
        page = render_html(document.build_document(result)).decode()
    return text_of(page).replace("\N{NO-BREAK SPACE}", " ")


def text_of(page: str) -> str:
    """Text of a page without tags, entities resolved."""
    return html.unescape(re.sub(r"<[^>]*>", " ", page))


def check_inside(figure: Figure) -> None:
    """Nothing drawn reaches beyond the figure.

    Of 3-D axes only their frame and labels are checked.
    """
    figure.draw_without_rendering()
    renderer: Any = FigureCanvasAgg(figure).get_renderer()
    for axes in figure.axes:
        if axes.get_visible():
            solid = isinstance(axes, Axes3D)
            parts = (axes.xaxis, axes.yaxis, axes.zaxis) if solid else (axes,)
            for part in parts:
                check_box(part.get_tightbbox(renderer), figure)


def check_box(box: Bbox | None, figure: Figure) -> None:
    """A rectangle lies within the figure, but for two pixels."""
    assert box is not None
    assert min(box.x0, box.y0) > -2.0
    assert box.x1 < figure.bbox.width + 2.0
    assert box.y1 < figure.bbox.height + 2.0


# -- whole results ---------------------------------------------------------------------


def sample() -> dict[str, Any]:
    """The whole result; every call builds the same one anew."""
    rng = np.random.default_rng(7)
    poses = report_fixture_machine.poses()
    return {
        "schema": 1,
        "version": "0.1.0",
        "study": "a3_ball_bar",
        "title": "A3 head with a double ball bar",
        "question": (
            "Which 30 readings of a ball bar, in which order, and how accurate is the"
            " head afterwards?"
        ),
        "seed": 20240607,
        "seconds": 41.7,
        "machine": report_fixture_machine.machine(),
        "setups": report_fixture_machine.setups(),
        "study_text": TEXT,
        "versions": {
            "python": "3.11.7",
            "numpy": "2.4.1",
            "casadi": "3.8.0",
            "pkm-oed": "0.1.0",
        },
        "headline": _headline(),
        "identifiability": _identifiability(24, 21, rng),
        "identifiability_of": {
            "one circle": _identifiability(21, 17, rng),
            "one tool length": _identifiability(21, 18, rng),
            "two tool lengths, two set-ups": _identifiability(24, 23, rng),
        },
        "design": report_fixture_design.design(poses),
        "kappa_maps": _kappa_maps(rng),
        "plan": _plan(),
        "estimate": report_fixture_fit.estimate(rng),
        "posterior": report_fixture_fit.posterior(rng),
        "prediction": report_fixture_fit.prediction(rng),
        "held_out": [
            report_fixture_fit.held_out("second day", 40, rng),
            report_fixture_fit.held_out("short tool, repeated", 12, rng),
        ],
        "drawing": report_fixture_machine.drawing(poses),
        "warnings": [
            "3 directions keep their tolerance: the platform's rotations about the TCP."
        ],
        "claims": _claims(),
    }


def bare() -> dict[str, Any]:
    """A result whose optional sections are all null or empty."""
    full = sample()
    full |= dict.fromkeys(SECTIONS)
    full |= {key: [] for key in LISTS}
    return full | {"identifiability_of": {}}


def delta() -> dict[str, Any]:
    """A machine commanded in x, y, z, known from probing heights; no posterior."""
    full = sample()
    full |= {
        "study": "delta",
        "title": "Linear delta with a height probe",
        "posterior": None,
        "kappa_maps": [],
        "prediction": report_fixture_fit.delta_prediction(np.random.default_rng(8)),
        "drawing": report_fixture_machine.delta_drawing(),
    }
    for estimate in full["estimate"]["parameters"].values():
        estimate["truth"] = None
    return full


# -- sections --------------------------------------------------------------------------


def _headline() -> list[str]:
    return [
        "The plan sees 21 of 24 parameters; 3 directions are lost.",
        (
            "30 readings in 2 set-ups reach log det -58.68, 2 % below the bound of"
            " -58.20 in D-efficiency."
        ),
        "The condition number over the seen directions is 3748.",
        (
            "Relative to home, z is known to 66 µm and the spindle axis to 5.2"
            " arcsec (1 sigma, rms) afterwards."
        ),
        "The virtual machine realised 0.97 of the predicted error.",
    ]


def _identifiability(n: int, rank: int, rng: np.random.Generator) -> dict[str, Any]:
    logarithms = rng.uniform(math.log(1.2e-3), math.log(4.7), rank)
    values = np.sort(np.exp(logarithms))[::-1]
    zeros = 1e-16 * (1.0 + rng.random(n - rank))
    lost = {"da1y": 0.41, "da2x": -0.35, "da2y": -0.2, "da3x": 0.35, "da3y": -0.2}
    return {
        "parameters": report_fixture_machine.NAMES[:n],
        "n": n,
        "rank": rank,
        "tolerance": 1e-9,
        "scaling": "lengths in mm, angles times 540 mm",
        "singular_values": [*values.tolist(), *zeros.tolist()],
        "combinations": [
            {"da1x": 0.577, "da2x": 0.577, "da3x": 0.577},
            {"db2x": 0.71, "db3x": -0.71},
        ],
        "lost": [lost] * (n - rank),
        "words": _findings(n - rank),
    }


def _findings(lost: int) -> list[dict[str, Any]]:
    findings = [
        {
            "kind": "seen",
            "text": "Each of dq1, dq2, dq3, beta1, beta2, beta3 on its own.",
            "remedies": [],
        },
        {
            "kind": "combination",
            "text": (
                "Only the sum da1x + da2x + da3x (the platform triangle's shift in x),"
                " not its parts."
            ),
            "remedies": ["a second tool length of 100 mm more or less"],
        },
        {
            "kind": "weak",
            "text": "db1y: its standard deviation stays at 0.8 of its tolerance.",
            "remedies": [],
        },
        {
            "kind": "lost",
            "text": (
                "Rotations of the platform joints about the TCP: a bar sees a point,"
                " not an orientation."
            ),
            "remedies": [
                "a second tool length (two of the three)",
                "an instrument that reads orientation (all three)",
            ],
        },
    ]
    return findings if lost else findings[:-1]


def _kappa_maps(rng: np.random.Generator) -> list[dict[str, Any]]:
    maps = []
    for title, size in (
        ("cup taught by the machine", 1.0),
        ("cup as free unknown", 4.7),
    ):
        rows = [_kappa_row(size * factor, rng) for factor in (1.0, 0.62, 0.48)]
        maps.append(
            {
                "title": title,
                "circles": [2, 3, 4],
                "points": list(range(9, 25)),
                "kappa": rows,
            }
        )
    return maps


def _kappa_row(factor: float, rng: np.random.Generator) -> list[float | None]:
    """Condition numbers of a line; the first is not finite."""
    sizes = [61000.0, 9000.0, *KAPPA]
    return [None, *[factor * size * (1.0 + 0.02 * rng.random()) for size in sizes]]


def _plan() -> dict[str, Any]:
    return {
        "stages": [
            _stage("one circle", ["short tool"], 17, 8120.0),
            _stage("second circle", ["long tool"], 4, 3748.0),
        ],
        "cost": 33.0,
        "alternatives": ["A length gauge along z halves the error of z."],
    }


def _stage(name: str, setups: list[str], rank: int, kappa: float) -> dict[str, Any]:
    return {
        "measurement": name,
        "setups": setups,
        "readings": 15 * len(setups),
        "identifies": rank,
        "cost": 16.5 * len(setups),
        "kappa": kappa,
        "predicted": {"z_um": 66.0, "theta_arcsec": 5.2},
    }


def _claims() -> list[dict[str, Any]]:
    return [
        _claim("rank of the plan", 21.0, "= 21"),
        _claim("log det of the chosen plan", -58.68, ">= -58.70"),
        _claim("realised over predicted", 0.97, "0.8 .. 1.25"),
        _claim("spindle axis, rms [arcsec]", 5.2, "<= 4", met=False),
    ]


def _claim(
    claim: str, measured: float, wanted: str, *, met: bool = True
) -> dict[str, Any]:
    return {"claim": claim, "measured": measured, "wanted": wanted, "met": met}
