"""A printed value and its unit belong together; another kernel of the BLAS library prints the same."""

import csv
import html
import json
import math
import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import report_fixture
import sample

from oed import units
from pkm_studies.commands import main

STUDY = """\
schema = 1
name = "units"

[machine]
model = "a3_head"

[[setup]]
name = "gimbal"
instrument = "laser_ball_bar"
at_x_mm = 800.0
at_y_mm = 100.0
at_z_mm = 500.0

[design]
readings = 12
starts = 1

[[design.candidates]]
setup = "gimbal"
z_mm = { from = 1086.0, to = 1246.0, count = 3 }
psi_deg = { from = 0.0, to = 270.0, count = 4 }
theta_deg = [10.0, 30.0]

[readings]
simulate = true
draw = true

[posterior]
enabled = false

[prediction]
z_mm = [1100.0, 1200.0]
psi_deg = [0.0, 120.0, 240.0]
theta_deg = [20.0]
wanted = { z_um = 50 }

[report]
pdf = false
"""
#: units in place of the usual ones: a factor of 1000, so that digits stay
OTHERS = {
    "DISPLAY": {"m": "um", "rad": "urad"},
    "FINE": {"m": "nm", "rad": "urad"},
    "EFFECT": {"m": ("nm", 1e-9), "rad": ("mrad", 1e-3)},
}
#: numbers beside a unit that is not theirs: a probability, and a total error
WITHOUT = ("power", "without")
ROUNDING = 0.06  #: share by which printed digits may differ
LENGTHS = ("nm", "um", "mm")
ANGLES = ("urad", "mrad", "arcsec", "deg")
FACTOR = {unit: units.factor(unit) for unit in (*LENGTHS, *ANGLES)}
UNIT = "|".join(sorted(FACTOR, key=len, reverse=True))
NUMBER = r"[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"


class Printed(NamedTuple):
    """An SI value as it was printed, and where."""

    where: str
    value: float
    text: str


def plain(text: str) -> str:
    """A page's or a terminal's text; cells of tables do not run together."""
    text = re.sub(r"<(script|style|svg).*?</\1>", "", text, flags=re.S)
    text = html.unescape(re.sub(r"<[^>]+>", " | ", text))
    for printed, usual in {"µ": "u", "°": "deg", "\u2212": "-", "\u2009": ""}.items():
        text = text.replace(printed, usual)
    return text.replace("\N{NO-BREAK SPACE}", " ").replace("\u202f", "")


def of_text(text: str) -> Iterator[Printed]:
    """Numbers before a unit, known by the words before them."""
    text = plain(text)
    for found in re.finditer(rf"({NUMBER}) *({UNIT})\b", text):
        before = text[max(0, found.start() - 80) : found.start()]
        words = re.sub(rf"\b({UNIT})\b|{NUMBER}|[^A-Za-z|]+", "", before)
        value = float(found[1].replace(",", "")) * FACTOR[found[2]]
        yield Printed(words[-20:], value, before[-40:] + found[0])


def of_table(text: str) -> Iterator[Printed]:
    """Columns whose names end in a unit."""
    rows = [line for line in text.splitlines() if not line.startswith("#")]
    for number, row in enumerate(csv.DictReader(rows)):
        for name, cell in row.items():
            stem, _, unit = str(name).rpartition("_")
            if unit in FACTOR and cell:
                where = f"{stem} row {number}"
                yield Printed(where, float(cell) * FACTOR[unit], f"{name} {cell}")


def of_json(value: object, where: str = "") -> Iterator[Printed]:
    """Fields with their unit in the name, or in a field `unit` beside them."""
    if isinstance(value, list):
        for number, item in enumerate(value):
            yield from of_json(item, f"{where}[{number}]")
    if not isinstance(value, dict):
        return
    beside = str(value.get("unit"))
    for name, item in value.items():
        stem, _, unit = name.rpartition("_")
        if unit not in FACTOR:
            stem, unit = name, beside
        if isinstance(item, float) and unit in FACTOR and name not in WITHOUT:
            text = f"{where}.{name} {item}"
            yield Printed(f"{where}.{stem}", item * FACTOR[unit], text)
        yield from of_json(item, f"{where}.{stem if unit in FACTOR else name}")


def contradictions(usual: list[Printed], other: list[Printed]) -> tuple[int, list[str]]:
    """How many values were printed twice, and which are not the same."""
    there = defaultdict(list)
    for printed in other:
        there[printed.where].append(printed)
    count, differing = 0, []
    for where in dict.fromkeys(p.where for p in usual):
        here = [p for p in usual if p.where == where]
        if len(here) != len(there[where]):
            continue
        for a, b in zip(here, there[where], strict=True):
            count += 1
            if not math.isclose(a.value, b.value, rel_tol=ROUNDING, abs_tol=5e-9):
                differing.append(f"{a.text} <> {b.text}")
    return count, differing


def in_both(commands: list[list[str]], tmp_path: Path, monkeypatch, capsys) -> list:
    """Folder and terminal of commands with the usual units, and with others."""
    outputs = []
    for name in ("usual", "other"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "units.study.toml").write_text(STUDY, encoding="utf-8")
        monkeypatch.chdir(folder)
        if name == "other":
            for table, values in OTHERS.items():
                for si, unit in values.items():
                    monkeypatch.setitem(getattr(units, table), si, unit)
        capsys.readouterr()
        for command in commands:
            assert main(command) == 0
        outputs.append((folder, capsys.readouterr().out))
    return outputs


def test_the_advice_states_angles_in_their_unit(tmp_path, monkeypatch, capsys):
    commands = [
        ["simulate", "units.study.toml", "--out", "r.csv"],
        ["next", "units.study.toml", "--readings", "r.csv"],
    ]
    (_, usual), (_, other) = in_both(commands, tmp_path, monkeypatch, capsys)
    assert "read_alpha" in usual
    advised = [list(of_text(text.partition("Rms error")[2])) for text in (usual, other)]
    count, differing = contradictions(*advised)
    assert count >= 8, advised
    assert not differing


@pytest.mark.slow
def test_every_printed_value_has_its_own_unit(tmp_path, monkeypatch, capsys):
    commands = [
        ["run", "units.study.toml", "--out", "out"],
        ["compensate", "out", "--to", "csv", "--force"],
        ["compensate", "out", "--to", "json", "--force"],
        ["verify", "out"],
        ["adjust", "out"],
        ["report", "out"],
    ]
    pair = in_both(commands, tmp_path, monkeypatch, capsys)
    readers = {
        "terminal": lambda folder, out: of_text(out),
        "report.html": lambda folder, out: of_text(
            (folder / "out/report.html").read_text()
        ),
        **{
            f"{name}.json": lambda folder, out, name=name: of_json(
                json.loads((folder / f"out/{name}.json").read_text())
            )
            for name in ("result", "compensation")
        },
        **{
            f"{name}.csv": lambda folder, out, name=name: of_table(
                (folder / f"out/{name}.csv").read_text()
            )
            for name in ("poses", "adjust", "compensation")
        },
    }
    for name, read in readers.items():
        usual, other = (list(read(folder, out)) for folder, out in pair)
        count, differing = contradictions(usual, other)
        print(name, len(usual), count)
        assert not differing, (name, differing[:5])
        assert count >= len(usual) // 3, name


KERNEL_STUDY = (
    sample.changed(
        sample.STUDY,
        ("html = false", "html = true"),
        ("readings = 21", "readings = 24"),
    )
    + "\n[readings]\nsimulate = true\n[posterior]\nsteps = 300\ness = 200\n"
    "[prediction]\nvirtual_machines = 20\n"
    'z_mm = 1146.0\npsi_deg = [0.0, 120.0]\ntheta_deg = [10.0, 20.0]\nreference = "home"\n'
)
KERNELS = ("Nehalem", "Haswell")  #: kernels of very different instructions
#: what rounding may change: relative, and beside it of numbers that are nothing
RELATIVE, ABSOLUTE = 1e-5, 1e-9
#: the same of statistics of ranks, which two draws that change places move
RANKED = {"ess": 1e-4, "rhat": 1e-4}
ASIDE = ("seconds", "written")  #: keys whose numbers are of no computation


def _is_dynamic() -> bool:
    config: Any = np.show_config(mode="dicts")
    blas = config["Build Dependencies"]["blas"]
    return "DYNAMIC_ARCH" in str(blas.get("openblas configuration", ""))


def run(folder: Path, kernel: str) -> tuple[dict[str, Any], str, str]:
    """Result, text of the report, and the kernel that ran."""
    environment = {**os.environ, "OPENBLAS_CORETYPE": kernel, "OPENBLAS_VERBOSE": "2"}
    environment["OPENBLAS_NUM_THREADS"] = "1"
    command = [sys.executable, "-m", "pkm_studies.commands.cli", "run", "s.study.toml"]
    done = subprocess.run(
        [*command, "--quiet", "--out", kernel],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    result = json.loads((folder / kernel / "result.json").read_text("utf-8"))
    page = (folder / kernel / "report.html").read_text("utf-8")
    body = page[page.index("<body") : page.rindex("<script")]
    words = re.sub(r"(time\s+)[\d.]+\s+s\b", r"\1", report_fixture.text_of(body))
    return result, words, done.stdout + done.stderr


def pairs(
    first: Any, second: Any, path: str = ""
) -> Iterator[tuple[str, Any, Any, float]]:
    """Path, both values and the Monte Carlo error of every leaf of two results."""
    assert type(first) is type(second), path
    if isinstance(first, dict):
        assert first.keys() == second.keys(), path
        for key in first.keys() - set(ASIDE):
            errors = first.get("monte_carlo", {})
            for leaf in pairs(first[key], second[key], f"{path}.{key}"):
                yield (*leaf[:3], max(leaf[3], *errors.get(key, [0.0])))
    elif isinstance(first, list):
        assert len(first) == len(second), path
        for k, entries in enumerate(zip(first, second, strict=True)):
            yield from pairs(*entries, f"{path}[{k}]")
    else:
        yield path, first, second, 0.0


@pytest.mark.slow
@pytest.mark.skipif(not _is_dynamic(), reason="NumPy's BLAS has one kernel alone")
def test_another_kernel_changes_nothing_but_rounding(tmp_path):
    (tmp_path / "s.study.toml").write_text(KERNEL_STUDY, "utf-8")
    (first, page, words), (second, other_page, other_words) = (
        run(tmp_path, kernel) for kernel in KERNELS
    )
    if not all(k in w for k, w in zip(KERNELS, (words, other_words), strict=True)):
        pytest.skip("this processor has not both kernels")
    differing = 0
    for path, a, b, error in pairs(first, second):
        if not isinstance(a, float) or a == b:
            assert a == b, path
            continue
        relative = RANKED.get(path.rpartition(".")[2], RELATIVE)
        close = math.isclose(a, b, rel_tol=relative, abs_tol=max(ABSOLUTE, error))
        assert close, (path, a, b, error)
        differing += 1
    assert differing > 100  # the kernels do round differently
    assert first["posterior"]["marginals"]
    assert first["prediction"]["components"]["psi"]["after"]["monte_carlo"]
    assert page == other_page
