"""Cases of the second generator, which lies beside the project, as studies and readings.

The case's json hands on what a user would know: set-ups, instrument noise, tolerances,
gravity, screw lead and scale period. Two of these need a file of effects beside the
study, since no field of a study takes them. Covariates go through unchanged, but for
`repeat` 0, which means that a run repeats no other, and the hexapod's spin, which its
commands do not have.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import json
import math
import shutil
import subprocess
import sys
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness.worlds import Case
from oed.gap import GapProblem
from oed.noise import NoiseLaw

HERE = Path(__file__).resolve().parent
#: where the generator lies, beside the project's folder
GENERATOR = HERE.parents[1].parent / "shared/generators/second"
MACHINES = ("a3", "planar", "delta", "hexapod")
MODELS = {
    "a3": "a3_head",
    "planar": "planar_2dof",
    "delta": "machines.py:delta",
    "hexapod": "machines.py:hexapod",
}
#: channels that a relative measurement reads
RELATIVE_CHANNELS = {"RM1": "y", "RM2": "z", "RM3": "z", "RM4": "y", "RM5": "yz"}
DRIVES = '''"""Cyclic errors with the lead and the period that this machine is known to have."""

import dataclasses

from pkm_models.effects import encoder_subdivision, screw_cyclic

lead = dataclasses.replace(
    screw_cyclic.effect, constants={{"pitch": ({lead}, {half_lead})}}
)
period = dataclasses.replace(
    encoder_subdivision.effect, constants={{"period": ({period},)}}
)
'''


def generate(
    folder: Path, seed: int, count: int, machines: Sequence[str] = MACHINES
) -> None:
    """Let the generator draw a set: `count` cases of each machine that has none yet.

    Raises FileNotFoundError where there is no generator, CalledProcessError.
    """
    for machine in machines:
        if labels_file(folder, machine).is_file():
            continue
        script = GENERATOR / "make.py"
        if not script.is_file():
            raise FileNotFoundError(script)
        out = labels_file(folder, machine).with_name(machine)
        options = ["--seed", str(seed), "--n", str(count), "--machine", machine]
        command = [sys.executable, "-B", str(script), *options, "--out", str(out)]
        subprocess.run(command, check=True)


def labels_file(folder: Path, machine: str) -> Path:
    """Where the generator writes the labels of a machine's cases in a set."""
    return folder / "cases" / f"{machine}.labels.json"


def draw(setting: Mapping[str, Any], number: int, folder: Path) -> Case:
    """A case of a set; the setting names the folder of the set, and the machine.

    Raises ValueError for a number beyond the set's cases, OSError.
    """
    machine = setting["machine"]
    labels = json.loads(
        labels_file(Path(setting["folder"]), machine).read_text("utf-8")
    )
    names = sorted(labels)
    if number >= len(names):
        raise ValueError(
            f"the set has {len(names)} cases of {machine}: give the campaign --seeds"
            f" {len(names)}, or generate more in another folder than {setting['folder']}"
        )
    name = names[number]
    stem = Path(setting["folder"]) / "cases" / machine / name
    return case_of(stem, labels[name], folder)


def case_of(stem: Path, label: Mapping[str, Any], folder: Path) -> Case:
    """The case whose files have this path without their suffixes."""
    study, readings = write_case(stem, folder)
    return Case(
        name=stem.name,
        study=study,
        readings=readings,
        label=label,
        stream=zlib.crc32(f"{label['machine']}/{stem.name}".encode()),
        true_law=functools.partial(true_law, law=label["law"]),
    )


def true_law(problem: GapProblem, law: Mapping[str, Any]) -> NoiseLaw:
    """The noise law of a label; outliers and tails are left to the diagnosis."""
    correlation = law.get("rho", math.exp(-1.0))
    carried = law.get("ar_over_sigma", 0.0)
    within, stated = math.hypot(1.0, carried), problem.stated_law.law
    changed = dataclasses.replace(
        stated,
        scale=within * stated.scale,
        correlated=np.array([(carried / within) ** 2]),
        reach=np.array([-1.0 / math.log(correlation)]),
        level=np.array([law.get("repeat_over_sigma", 0.0) / within]),
    )
    return NoiseLaw(changed)


# -- files -----------------------------------------------------------------------------
def write_case(stem: Path, out: Path) -> tuple[Path, Path]:
    """Write study, machines, effects and readings of the case at `stem` into `out`.

    Returns the paths of study and readings. Raises OSError, ValueError.
    """
    case = json.loads(stem.with_suffix(".json").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    study, readings = out / "case.study.toml", out / "case.readings.csv"
    (out / "drives.py").write_text(_drives(case), encoding="utf-8")
    shutil.copyfile(HERE / "machines.py", out / "machines.py")
    study.write_text(_study(case), encoding="utf-8")
    _copy_readings(stem.with_suffix(".readings.csv"), readings, case["machine"])
    return study, readings


def _drives(case: Mapping[str, Any]) -> str:
    lead, period = 1e-3 * case["screw_lead_mm"], 1e-3 * case["scale_period_mm"]
    return DRIVES.format(lead=lead, half_lead=0.5 * lead, period=period)


def _study(case: Mapping[str, Any]) -> str:
    """The study file's text."""
    setups = case["setups"]
    effects = ["all", "drives.py:lead", "drives.py:period"]
    gravity = [float(v) for v in case["down"]]
    parts = [
        'schema = 1\nname = "second_generator"\nseed = 1\n',
        f'[machine]\nmodel = "{MODELS[case["machine"]]}"\nfixed = []\n',
        *[_setup(s) for s in setups],
        "[noise]\n" + "".join(_noise(s) for s in setups),
        *_tolerances(case["machine"], case["tolerances"]),
        f"[gap]\neffects = {json.dumps(effects)}\ngravity = {gravity}\n",
    ]
    return "\n".join(parts)


def _setup(setup: Mapping[str, Any]) -> str:
    """A [[setup]] table."""
    kind = setup["instrument"]
    lines = [f'[[setup]]\nname = "{setup["name"]}"']
    if kind == "ball_bar":
        lines.append('instrument = "ball_bar_free_cup"')
        lines.append(f"length_mm = {setup['bar_mm']!r}")
        for axis, value in zip("xyz", setup["cup_mm"], strict=True):
            lines.append(f"at_{axis}_mm = {float(value)!r}")
        lines.append(f"tool_mm = [0.0, 0.0, {setup['tool_mm']!r}]")
        lines.append("tolerance = { cup_x_mm = 0.1, cup_y_mm = 0.1, cup_z_mm = 0.1 }")
    elif kind == "relative":
        lines.append(f'instrument = "{setup["measurement"].lower()}"')
    elif kind == "height_probe":
        lines.append('instrument = "length_gauge"\nat_z_mm = 0.0')
        tilts = "tilt_x_mrad = 0.5, tilt_y_mrad = 0.5"
        lines.append(f"tolerance = {{ height_mm = 0.1, {tilts} }}")
    elif kind == "calliper":
        lines.append('instrument = "calliper"\ntolerance = { scale_ppm = 0.0 }')
    else:
        raise ValueError(
            f"{setup['name']}: instrument {kind!r} is unknown; adapt _setup to it"
        )
    return "\n".join(lines) + "\n"


def _noise(setup: Mapping[str, Any]) -> str:
    """A set-up's line of [noise]."""
    channels = ["length_um"]
    if setup["instrument"] == "relative":
        channels = [f"d{c}_um" for c in RELATIVE_CHANNELS[setup["measurement"]]]
    elif setup["instrument"] == "height_probe":
        channels = ["height_um"]
    values = ", ".join(f"{channel} = {setup['sigma_um']!r}" for channel in channels)
    return f"{setup['name']} = {{ {values} }}\n"


def _tolerances(machine: str, stated: Sequence[Mapping[str, Any]]) -> list[str]:
    """[[prior.tolerance]] tables: parameters of one tolerance together."""
    groups: dict[tuple[float, str], list[str]] = {}
    for entry in stated:
        name = _parameter(machine, entry["parameter"])
        if name is not None:
            groups.setdefault((entry["sd"], entry["unit"]), []).append(name)
    return [
        f"[[prior.tolerance]]\nparameters = {json.dumps(names)}\n"
        f"sigma_{unit} = {sd!r}\n"
        for (sd, unit), names in groups.items()
    ]


def _parameter(machine: str, name: str) -> str | None:
    """The toolkit's name of a parameter; None for an unknown of a set-up."""
    if name.startswith(("cup_", "bed")):
        return None
    if machine == "planar":
        return name.replace("q", "z")
    if machine == "delta":
        return f"d{name}" if name.startswith("q") else name
    return name if name.startswith("beta") else f"d{name}"


def _copy_readings(source: Path, target: Path, machine: str) -> None:
    with source.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    if "repeat" in header:
        at = header.index("repeat")
        rows = [[*r[:at], "" if r[at] == "0" else r[at], *r[at + 1 :]] for r in rows]
    if machine == "hexapod":
        header = [*header, "gamma_deg"]
        rows = [[*row, "0"] for row in rows]
    with target.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
