"""Broken studies and readings at random: sound, or one paragraph that says what is wrong.

Mutations come from Hypothesis. `oed check` runs in this process; whatever it raises fails
the test.
"""

import functools
import tempfile
from pathlib import Path

import sample
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oed.measurement import Measurement
from oed.mechanism import AssemblyError
from pkm_studies import sources
from pkm_studies.base import InputError
from pkm_studies.resolve import resolve
from pkm_studies.study import Study

STUDY_MUTATIONS = 50  #: mutations of studies, and of each of two readings files
READINGS_MUTATIONS = 75
STUDIES = (
    sample.STUDY,
    sample.DELTA
    + "[readings]\nsimulate = true\ntruth = { radius_mm = 0.1 }\n[prediction]\n"
    "virtual_machines = 2\nx_mm = [0.0, 10.0]\n[posterior]\nsteps = 100\n",
)
#: what replaces a number, a word or a cell
VALUES = (
    *("", "0", "-1", "1e9", "1e308", "-0.5", "nan", "inf", "1e-300", "99999999999999"),
    *("true", '""', '"x"', "[]", "{}", "[1, 2]", "{ from = 1.0 }", "'cup'", "é", "\0"),
    *("1,5", '"', "=", "[", "1979-05-27", "repeat", "length_mm", "-", ";", "\t", "psi"),
)
LIMITS = ' \n=,;[]{}"'  #: characters that end a token of a study, or a cell


def tokens(text: str) -> list[str]:
    """Words, numbers and signs in order; joined they are the text."""
    parts, word = [], ""
    for character in text:
        if character in LIMITS:
            parts += [word, character]
            word = ""
        else:
            word += character
    return [part for part in (*parts, word) if part]


@st.composite
def mutated(draw: st.DrawFn, texts: tuple[str, ...]) -> str:
    """A text with one to three tokens replaced, removed, doubled or exchanged."""
    parts = tokens(draw(st.sampled_from(texts)))
    for _ in range(draw(st.integers(1, 3))):
        i, j = (draw(st.integers(0, len(parts) - 1)) for _ in range(2))
        kind = draw(st.sampled_from(["replace"] * 4 + ["remove", "double", "exchange"]))
        if kind == "replace":
            value = st.one_of(st.sampled_from(VALUES), st.text(max_size=4))
            parts[i] = draw(value)
        elif kind == "remove":
            parts[i] = ""
        elif kind == "double":
            parts[i] *= 2
        else:
            parts[i], parts[j] = parts[j], parts[i]
    return "".join(parts)


def assert_helpful(error: InputError, file: str) -> None:
    """One paragraph with the file, the place or the problem, and a remedy."""
    text = str(error)
    assert error.file == file
    assert error.problem
    assert error.remedy
    assert "\n" not in text
    assert len(text) <= 600


def check_study(text: str) -> None:
    try:
        resolve(Study.parse(text, Path("s.study.toml")))
    except InputError as error:
        assert_helpful(error, "s.study.toml")
    except AssemblyError:
        pass  # `oed check` names the file itself


@functools.cache
def measurement(study: str) -> Measurement:
    resolved = resolve(Study.parse(study, Path("s.study.toml")), readings=())
    return resolved.measurement_with(resolved.setups)


def check_readings(study: str, text: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.csv"
        path.write_text(text, encoding="utf-8", errors="surrogateescape", newline="")
        try:
            sources.read_files([path], measurement(study))
        except InputError as error:
            assert_helpful(error, str(path))


def test_200_mutations():
    options = settings(
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    some = settings(options, max_examples=STUDY_MUTATIONS)
    some(given(mutated(STUDIES))(check_study))()
    some = settings(options, max_examples=READINGS_MUTATIONS)
    files = ((sample.STUDY, sample.READINGS), (sample.DELTA, sample.DELTA_READINGS))
    for study, text in files:
        some(given(st.just(study), mutated((text,)))(check_readings))()
