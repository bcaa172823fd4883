"""The report's chapters about the design: all of it told, missing parts left out,
figures against the numbers.
"""

from __future__ import annotations

import html
import itertools
import re
from typing import Any

import numpy as np
import pytest
import report_fixture

from oed.design.criterion import named
from pkm_reports import document, style
from pkm_reports import html as html_writer
from pkm_reports import pdf as pdf_writer
from pkm_reports.figures import compared, path, robust
from pkm_reports.sections import design, plan

CRITERIA = ("D", "Ds", "A", "c", "I", "G", "E", "kappa", "O1", "O2", "O3", "O4", "O5")


def _shown(result: dict[str, Any]) -> str:
    """Text of the page of a result, its no-break spaces as spaces."""
    page = html_writer.render(document.build(result)).decode()
    return html.unescape(re.sub(r"<[^>]*>", " ", page)).replace(
        "\N{NO-BREAK SPACE}", " "
    )


def test_the_certificate_and_its_numbers_are_told() -> None:
    shown = _shown(report_fixture.sample())
    for text in (
        report_fixture.sample()["design"]["words"],
        "−58.20: no choice is larger",
        "97.3 % of the best possible, at the least",
        "18 of 21",
        "30, of which 4 belonged to the plan before",
        "33 min to mount and to read",
        "67 % D and 33 % I",
        "short tool: 15 readings, no. 1 to 15",
        "travel for 95.6 s, 24 % less than the 126 s",
        (
            "3 thermal reference readings are put between. Mounting, travel and"
            " readings take 36.4 min"
        ),
        "brought criterion D from −58.91 to −58.68: polishing gained 0.01278",
        "at x 103.27 mm, at z 1281.5 mm",
        "the mean of the worst 20 % of 20 scenarios",
        (
            "Wanted: z 50 µm, theta 1.2 arcsec. 34 readings reach it; no plan of fewer"
            " than 33 can."
        ),
    ):
        assert text in shown, text


OPTIONAL = [
    *(
        "words",
        "directions",
        "columns",
        "gap",
        "proven",
        "compound",
        "setups",
        "kept",
        "cost_min",
        "refused",
    ),
    *(
        "compared",
        "polished",
        "order",
        "robust",
        "how_many",
        "bound",
        "efficiency",
        "plans",
        "poses",
    ),
]


@pytest.mark.parametrize("kind", ["absent", "null"])
def test_each_part_of_the_design_may_be_missing(kind: str) -> None:
    for names in [*[[name] for name in OPTIONAL], OPTIONAL]:
        result = report_fixture.bare() | {"design": report_fixture.sample()["design"]}
        for name in names:
            if kind == "absent":
                del result["design"][name]
            else:
                result["design"][name] = None
        told = repr(
            [*plan.blocks(result), *design.blocks(result)]
        )  # texts and captions; figures are not drawn
        assert not {"nan", "None"} & set(re.findall(r"\w+", told)), names
    assert "How good" in _shown(result)


def test_numbers_that_were_not_finite_leave_gaps() -> None:
    result = report_fixture.bare() | {"design": report_fixture.sample()["design"]}
    part = result["design"]
    part["compared"][1]["values"] = {"D": None, "E": 3.0e-6, "kappa": None}
    part["plans"][1]["predicted"]["z_um"] = None
    part["robust"]["values"][0] = None
    part["how_many"]["accuracy"]["z_um"][0] = None
    part["how_many"] |= {"fewest": None, "wanted": {}, "words": ""}
    assert pdf_writer.render(document.build(result)).startswith(b"%PDF")


def test_an_old_result_still_tells_its_certificate() -> None:
    old = {
        k: v
        for k, v in report_fixture.sample()["design"].items()
        if k not in OPTIONAL[:15]
    }
    shown = _shown(report_fixture.bare() | {"design": old})
    assert (
        "Certified to 97.3 % of the best possible 30 readings out of 1512 candidates."
        in shown
    )


@pytest.mark.parametrize("main", ["D", "Ds", "kappa"])
def test_efficiencies_are_ratios_of_phi(main: str) -> None:
    """Against phi itself, of random plans; the report knows only the numbers as told."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(13, 9, 4))
    informations = [h.T @ h for h in rows]
    pieces: dict[str, Any] = {
        "interest": np.eye(4)[:, :2],
        "factor": rng.normal(size=(1, 4)),
    }
    pieces["factors"] = rng.normal(size=(5, 2, 4))
    names = [main, *[name for name in CRITERIA if name != main]]
    criteria = {n: named(n, 4, **pieces) for n in names}
    phi = np.array([[c.value(m) for m in informations] for c in criteria.values()])
    entries = []
    for k, (name, criterion) in enumerate(criteria.items()):
        told = {
            n: criterion.conventional_value(float(v), 9)
            for n, v in zip(names, phi[k], strict=True)
        }
        head = {
            "name": name,
            "value": told[name],
            "bound": criterion.conventional_value(float(phi[k, k] + 0.2), 9),
        }
        entries.append(
            head
            | {
                "efficiency": np.exp(-0.2),
                "gain": np.exp(phi[k, k] - phi[k, 0]),
                "values": told,
            }
        )
    np.testing.assert_allclose(
        compared.efficiencies(entries), np.exp(phi - np.diag(phi)[:, None]), rtol=1e-9
    )
    for entry in entries:  # proven ones leave only the gain, and for D the directions
        entry |= {"bound": entry["value"], "efficiency": 1.0}
    again = compared.efficiencies(entries, 4)
    known = slice(0 if main != "Ds" else 1, None)
    np.testing.assert_allclose(
        again[known], np.exp(phi - np.diag(phi)[:, None])[known], rtol=1e-9
    )


def _poses(commands: list[dict[str, float]]) -> list[dict[str, Any]]:
    return [
        {"setup": "a", "run": "1", "order": k, "command": c, "reading": {}}
        for k, c in enumerate(commands)
    ]


def test_the_path_takes_the_coordinates_that_vary_most() -> None:
    poses = _poses(
        [
            {"a_mm": 1e3 * k, "b_um": 9e3 * k, "c_rad": 0.05 * k, "d_deg": 10.0 * k}
            for k in range(3)
        ]
    )
    plane = path.chosen(poses)  # 2000 mm, 18 mm, 5.7 degrees, 20 degrees
    assert plane is not None
    assert plane.names == ("a_mm", "d_deg")
    one = path.chosen(_poses([{"a_mm": 5.0, "b_mm": 1.0 * k} for k in range(3)]))
    assert one is not None
    assert one.names == ("reading", "b_mm")


def test_a_way_over_a_full_turn_is_the_short_one() -> None:
    poses = _poses(
        [
            {"z_mm": 0.0, "psi_deg": 350.0},
            {"z_mm": 10.0, "psi_deg": 20.0},
            {"z_mm": 20.0, "psi_deg": 120.0},
        ]
    )
    with style.applied():
        axes = path.draw(poses).axes[0]
    ways = [
        np.array(line.get_xydata())
        for line in axes.lines
        if len(line.get_xydata()) == 2
    ]
    lengths = [float(abs(way[1, 1] - way[0, 1])) for way in ways]
    assert lengths == pytest.approx([30.0, 30.0, 100.0])
    low, high = axes.get_ylim()
    assert high - low == pytest.approx(360.0)
    plane = path.chosen(poses)
    assert plane is not None
    assert path.around(plane, ["a", "a", "a"])
    assert not path.around(plane, ["a", "b", "b"])


@pytest.mark.parametrize("count", [12, 90, 400])
def test_numbers_of_the_path_do_not_overlap(count: int) -> None:
    rng = np.random.default_rng(5)
    commands = [
        {"z_mm": float(10 * rng.integers(12)), "psi_deg": float(15 * rng.integers(24))}
        for _ in range(count)
    ]
    with style.applied():
        figure = path.draw(_poses(commands))
        figure.draw_without_rendering()
        texts = figure.axes[0].texts
        boxes = [
            text.get_bbox_patch().get_window_extent()
            for text in texts
            if text.get_bbox_patch() is not None
        ]
    assert len(boxes) == len(texts) >= 10
    assert {"1", str(count)} <= {
        number for text in texts for number in text.get_text().split()
    }
    for a, b in itertools.combinations(boxes, 2):
        assert not (a.x0 < b.x1 and b.x0 < a.x1 and a.y0 < b.y1 and b.y0 < a.y1)


def test_the_strip_shows_the_share_of_scenarios() -> None:
    part = {
        "risk": "worst",
        "values": [0.0, np.log(0.5)],
        "nominal_values": [np.log(0.25)],
        "value": np.log(0.5),
    }
    with style.applied():
        axes = robust.draw(part).axes[0]
    steps = {line.get_label(): np.array(line.get_xydata()) for line in axes.lines}
    np.testing.assert_allclose(
        steps["robust plan, each scenario"], [[50.0, 50.0], [100.0, 100.0]]
    )
    np.testing.assert_allclose(steps["nominal plan, each scenario"], [[25.0, 100.0]])
    np.testing.assert_allclose(steps["robust plan, by the risk"][:, 0], 50.0)
