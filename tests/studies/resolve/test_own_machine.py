"""Errors for a mistake in a user's own machine name the function and a remedy."""

from pathlib import Path

import pytest

from pkm_studies.base import InputError
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
