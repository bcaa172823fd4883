"""A user's own machine: errors in its function, lengths in another unit, ranges that do not fit."""

import math
from pathlib import Path

import pytest

from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.resolve import resolve
from pkm_studies.study import Study

TUTORIAL = Path(__file__).resolve().parents[3] / "docs" / "tutorial"
GUESS = "return target(c), [INWARD[i] + 1.0 for i in LIMBS]"


def refusal(folder: Path, old: str, new: str) -> str:
    """The error that the tutorial's machine with one change raises."""
    text = (TUTORIAL / "my_machine.py").read_text(encoding="utf-8")
    assert old in text
    (folder / "my_machine.py").write_text(text.replace(old, new, 1), encoding="utf-8")
    study = folder / "circles.study.toml"
    study.write_text(
        (TUTORIAL / study.name).read_text(encoding="utf-8"), encoding="utf-8"
    )
    with pytest.raises(InputError) as caught:
        resolve(Study.load(study))
    return str(caught.value)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('ca.cos(x["phi"])', 'math.cos(x["phi"])', "not a number at the guess for home; use ca.cos"),
    ('x["phi"]), ca.sin', 'x["turn"]), ca.sin',
     "closure asks for 'turn', which the machine has not"),
    ('p[f"rod{i}"] for i in LIMBS]', 'p[f"rod{i}"] for i in LIMBS[:2]]',
     ("2 equations, not 3; there must be one for each: 3 pose + 3 joint - 3 command coordinates")),
    (GUESS, "return target(c)", "guess"),
    (GUESS, "return target(c), [1.0]",
     "guess (values for pose and joints) gives (3, 1), not (3, 3)"),
    (GUESS, "return target(c), [INWARD[i] for i in LIMBS]",
     "at its guess, the closure's equations 1 to 3 are -0.17, -0.17, -0.17"),
    ('p[f"rod{i}"] for i in LIMBS]', 'p[f"rod{i}"] * (3 if i == 2 else 1) for i in LIMBS]',
     "a large one names the strut whose ends or length are wrong"),
    ('[tip[0], tip[1], x["phi"]]', "[tip[0], tip[1]]", "commanded gives 2, not 3"),
    ("    read_error=lambda c, twist: [twist[0], twist[1], twist[5]],\n", "",
     "phi would be read as a translation"),
    ("[twist[0], twist[1], twist[5]]", "[twist[0], twist[1]]", "read_error gives 2, not 3"),
    ("[tip[0], tip[1], x", "[tip.x, tip[1], x", "commanded fails with AttributeError"),
    ("LIMBS = (1, 2, 3)", "LIMBS = (1, 2", "importing it failed with SyntaxError"),
    ("lever=BASE", "levre=BASE", "importing it failed with TypeError"),
])  # fmt: skip
def test_a_mistake_is_named(old, new, words, tmp_path):
    message = refusal(tmp_path, old, new)
    assert words in message
    assert "machine.model" in message
    assert "\n" not in message


def test_poses_where_the_bar_cannot_hold_its_length_give_a_warning(tmp_path):
    """A bar holds its length, so 100 mm cannot be read at a radius of 40 mm."""
    for name in ("my_machine.py", "circles.study.toml"):
        text = (TUTORIAL / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(
            text.replace('r = "hold"', "r_mm = [40.0, 100.0]"), encoding="utf-8"
        )
    (warning,) = resolve(Study.load(tmp_path / "circles.study.toml")).warnings
    assert (
        "at 120 of 240 poses centre would read 40 mm to 100 mm, but it holds 100 mm"
        in warning
    )
    assert not resolve(Study.load(TUTORIAL / "circles.study.toml")).warnings


MACHINE = """
import casadi as ca
from oed import Component, Coordinate, Machine, Parameter

L = 0.700
A = {1: -0.300, 2: 0.300}


def closure(x, q, p):
    return [
        ca.norm_2(ca.vertcat(x["x"] - A[i], x["y"] - q[f"q{i}"])) - p[f"rod{i}"]
        for i in A
    ]


def guess(c, p):
    x, y = c["x"], c["y"]
    return [x, y], [y + ca.sqrt(p[f"rod{i}"] ** 2 - (x - A[i]) ** 2) for i in A]


plane = [Coordinate("x", "m", -0.1, 0.1), Coordinate("y", "m", 0.0, 0.5)]
machine = Machine(
    name="rails",
    source="drawing",
    pose=tuple(Coordinate(c.name, "m") for c in plane),
    joints=tuple(Coordinate(f"q{i}", "m", 0.0, 1.4) for i in A),
    command=tuple(plane),
    home={"x": 0.0, "y": 0.25},
    parameters=tuple(Parameter(f"rod{i}", L, 1e-4, "m") for i in A),
    components=tuple(Component(c.name, "m", True) for c in plane),
    lever=0.5,
    closure=closure,
    platform=lambda x: (ca.DM.eye(3), ca.vertcat(x["x"], x["y"], 0.0)),
    commanded=lambda x, tip: [tip[0], tip[1]],
    target=lambda c: [c["x"], c["y"]],
    guess=guess,
    read_error=lambda c, twist: twist[:2],
)
"""


def checked(
    folder: Path, capsys: pytest.CaptureFixture[str], *changes: tuple[str, str]
) -> tuple[int, str]:
    """Exit code and text of `oed check rails.py`, with changes of the file."""
    text = MACHINE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "rails.py").write_text(text, encoding="utf-8")
    capsys.readouterr()
    code = main(["check", str(folder / "rails.py"), "--allow-code"])
    out, err = capsys.readouterr()
    return code, out + err


def test_rods_of_700_m_are_refused_by_the_joints_that_they_need(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, text = checked(tmp_path, capsys)
    assert code == 0
    assert text.endswith("closes at its home pose\n")
    code, text = checked(tmp_path, capsys, ("L = 0.700", "L = 700.0"))
    assert code == 2
    needed = 1e3 * (0.25 + math.sqrt(700.0**2 - 0.3**2))
    assert f"x = 0 mm, y = 250 mm needs q1 = {needed:.6g} mm, outside" in text
    assert "q1 goes from 0 mm to 1400 mm: check the numbers and their units" in text
    assert main(["new", "--machine", "rails.py", "--allow-code"]) == 2
    assert "outside the joint's range" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.toml"))


def test_joints_are_compared_with_their_ranges_over_the_workspace(tmp_path, capsys):
    """At y = 900 mm the carriages stand at 1474 mm to 1570 mm, beyond 1400 mm."""
    high = ('"y", "m", 0.0, 0.5', '"y", "m", 0.0, 0.9')
    code, text = checked(tmp_path, capsys, high)
    assert code == 0
    assert "3 of 9 poses at the ends and middles of the workspace need joints" in text
    assert "the first at x = -100 mm, y = 900 mm" in text


def test_a_length_without_proportion_is_doubted(tmp_path, capsys):
    """Joints without ends refuse nothing: the rods are long beside all that moves."""
    free = (', "m", 0.0, 1.4', ', "m"')
    code, text = checked(tmp_path, capsys, free)
    assert "in m" not in text
    code, text = checked(tmp_path, capsys, free, ("L = 0.700", "L = 700.0"))
    assert code == 0
    assert "rod1 is 700000 mm, and nothing of the machine moves beyond 500 mm" in text


def test_a_studys_own_numbers_are_held_to_the_same(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rails.py").write_text(MACHINE, encoding="utf-8")
    assert main(["new", "--machine", "rails.py", "--allow-code"]) == 0
    text = Path("rails.study.toml").read_text(encoding="utf-8")
    rods = "[machine.nominal]\nrod1_mm = 7000.0\nrod2_mm = 7000.0\n\n[[setup]]"
    Path("long.study.toml").write_text(text.replace("[[setup]]", rods), "utf-8")
    capsys.readouterr()
    assert main(["check", "long.study.toml"]) == 2
    assert "long.study.toml: machine: the pose x = 0 mm" in capsys.readouterr().err
