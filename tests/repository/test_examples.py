"""Examples in docstrings of the names a user meets first: each is run as it stands."""

import doctest
import importlib
from typing import Any

import pytest

import oed

#: what a room offers to users of arrays
ROOMS = {
    "oed.accuracy": ("ErrorMaps", "predict"),
    "oed.design": ("Choice", "choose"),
    "oed.estimation": ("Estimate", "identify"),
    "oed.gap": ("diagnose", "prepare"),
    "oed.identifiability": ("analyse",),
    "oed.measurement": ("Series", "draw_parameters", "draw_readings"),
    "oed.posterior": ("sample", "to_arviz"),
}
FACE = [("oed", name) for name in oed.__all__ if name != "__version__"]
NAMES = FACE + [(room, name) for room, names in ROOMS.items() for name in names]
#: examples of seconds, whose steps tests/studies/notebook runs
LONG = {("oed", name) for name in ("diagnose", "plan", "run", "choose_design")}
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


@pytest.mark.parametrize(
    ("room", "name"),
    [pytest.param(*n, marks=[pytest.mark.slow] if n in LONG else []) for n in NAMES],
    ids=lambda part: part,
)
def test_the_example_runs(room, name, tmp_path, monkeypatch):
    value: Any = getattr(importlib.import_module(room), name)
    text = value.__doc__
    assert ">>>" in text, f"{room}.{name} has no example"
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    failures: list[str] = []
    doctest.DocTestRunner(optionflags=FLAGS).run(example, out=failures.append)
    assert not failures, "".join(failures)
