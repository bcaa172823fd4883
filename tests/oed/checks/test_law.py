"""A noise law without readings: its scales, and the noise that it gives a session."""

import blunder_machines as machines
import numpy as np
import pytest

from kernel.dense_noise import dense_covariance
from oed.checks.session import CheckedLaw
from oed.measurement import reading_structure
from oed.noise import Laws, SharedError


def law_of(scale: dict[str, float], level: float = 0.0) -> CheckedLaw:
    numbers = ([[1.0]], [0.3], [4.0], [level], [0.0])
    return CheckedLaw(scale, Laws(*map(np.array, numbers)), np.zeros(0))


def test_noise_of_a_session_has_the_laws_covariance(rng):
    """Groups that the law does not know are as stated."""
    session = machines.session("a3", machines.readings("a3", 1))
    m = session.measurement
    structure = reading_structure(m, session.series, m.nominal)
    name, other = structure.names
    law = law_of({name: 3.0}, level=0.8)
    laws = law.laws(structure)
    assert laws.scale.tolist() == [[3.0, 1.0]]
    dense = dense_covariance(structure, laws) * np.outer(structure.unit, structure.unit)
    white = law.noise(m, session.series).whiten(np.eye(len(session)))
    precision = white.T @ white
    assert precision @ dense == pytest.approx(np.eye(len(session)), abs=1e-8)
    assert other != name


def test_the_size_is_the_largest_standard_deviation():
    session = machines.session("a3", machines.readings("a3", 1))
    m = session.measurement
    structure = reading_structure(m, session.series, m.nominal)
    first, second = structure.names
    law = law_of({first: 3.0, second: 0.5}, level=0.8)
    laws = law.laws(structure)
    dense = np.diag(dense_covariance(structure, laws))
    assert set(structure.kinds.tolist()) >= {SharedError.LEVEL}
    assert law.size(structure) == pytest.approx(np.sqrt(dense.max()))


def test_scales_are_kept_between_ends():
    law = law_of({"a.length": 0.2, "b.length": 1.7, "c.length": 9.0})
    limited = law.with_scale(0.5, 4.0)
    assert limited.scale == {"a.length": 0.5, "b.length": 1.7, "c.length": 4.0}
    assert law.scale["a.length"] == 0.2
