"""A small study that tests change and break, and the measurement it describes."""

from __future__ import annotations

from pathlib import Path

import pytest

from pkm_studies.base import InputError
from pkm_studies.resolve.resolved import ResolvedStudy, resolve
from pkm_studies.study import parse

STUDY = """\
schema = 1
name = "small"

[machine]
model = "a3_head"

[[setup]]
name = "cup"
instrument = "ball_bar"
length_mm = 300.0
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }

[noise]
length_um = 0.5

[design]
criterion = "D"
readings = 21

[[design.candidates]]
setup = "cup"
z_mm = { from = 1066.0, to = 1266.0, count = 4 }
psi_deg = { from = 0.0, to = 360.0, count = 12, endpoint = false }
theta = "hold"

[report]
html = false
pdf = false

[expect]
rank = { of = "identifiability.rank", equals = 18 }
"""

DELTA = """\
schema = 1
name = "small_delta"

[machine]
model = "linear_delta"

[[setup]]
name = "probe"
instrument = "height_probe"

[[setup]]
name = "calliper"
instrument = "calliper"
"""

READINGS = """\
setup,run,order,z_mm,psi_deg,theta_deg,time_s,direction,temp_bar_C,length_mm
cup,low,1,1146,0,30,0,1,0.5,300.001
cup,low,2,1146,90,30,6,1,,300.002
cup,low,3,1146,180,30,12,-1,0.6,
cup,high,1,1266,0,35,20,1,0.7,299.999
"""

DELTA_READINGS = """\
setup,run,order,q1_mm,q2_mm,q3_mm,height_mm,length_mm
probe,1,1,400,400,400,18.1,
probe,1,2,390,410,400,18.2,
calliper,d1,1,410,400,400,,
calliper,d1,2,380,400,420,,64.7
calliper,d2,1,400,400,410,,
calliper,d2,2,400,420,380,,64.8
"""


FIGURES = "def figures(setting, seed):\n    return {'sum': seed + setting['one']}\n"
CAMPAIGN = """\
schema = 1
name = "own"
case = "own_case.py:figures"
seeds = 2
[vary]
one = {one}
"""


def write_campaign(folder: Path, one: list[int]) -> None:
    """own.campaign.toml with two seeds of each value, and the file of its case."""
    text = CAMPAIGN.format(one=one)
    (folder / "own_case.py").write_text(FIGURES, encoding="utf-8")
    (folder / "own.campaign.toml").write_text(text, encoding="utf-8")


def changed(text: str, *changes: tuple[str, str]) -> str:
    """The text with each change made; fails where there is nothing to change."""
    for old, new in changes:
        assert old in text, f"{old!r} is not in the text"
        text = text.replace(old, new, 1)
    return text


def resolved(text: str = STUDY, folder: Path = Path()) -> ResolvedStudy:
    """The objects of a study given as text."""
    return resolve(parse(text, folder / "small.study.toml"))


def refused(text: str, *changes: tuple[str, str], folder: Path = Path()) -> InputError:
    """The error of a study that is changed: one line of limited length."""
    with pytest.raises(InputError) as error:
        resolved(changed(text, *changes), folder)
    assert len(str(error.value)) <= 600
    assert "\n" not in str(error.value)
    return error.value


def table_lines(text: str) -> list[str]:
    """Header and rows of a CSV, without the comments above them."""
    return [line for line in text.splitlines() if not line.startswith("#")]
