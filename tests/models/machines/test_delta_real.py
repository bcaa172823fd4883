"""Real readings of a linear delta: the published fits are reproduced, and one session
predicts another.
"""

from pathlib import Path

import numpy as np
import pytest
from delta_sessions import (
    MM,
    Session,
    distances_of,
    fitted,
    heights_of,
    measurement,
    sessions,
)
from oracles import delta_trilateration as delta
from reference import delta_v400 as published

from oed.estimation import identify
from oed.identifiability import Identifiability, analyse
from oed.measurement import Measurement, Series
from pkm_studies import study
from pkm_studies.resolve import resolved as resolve

__all__ = ["measurement", "sessions"]  # fixtures

ROOT = Path(__file__).resolve().parents[3]
ARMS = ("arm1", "arm2", "arm3")


def rms_mm(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)) / MM)


@pytest.mark.parametrize("name", published.FIRMWARE_RMS)
def test_the_firmwares_fit_leaves_its_published_residuals(measurement, sessions, name):
    session, (heights, distances) = sessions[name], published.FIRMWARE_RMS[name]
    theta = np.r_[session.firmware, np.zeros(len(measurement.names) - 10)]
    read = measurement.readings([heights_of(measurement, session)], theta)
    assert rms_mm(read - session.heights) == pytest.approx(heights, abs=1e-6)
    nozzle = delta.nozzle(
        session.contacts, theta[0], theta[1:4], theta[4:7], theta[7:10]
    )
    assert read == pytest.approx(nozzle[:, 2], abs=1e-13)
    if distances is None:
        assert len(session.distances) == 0
    else:
        read = measurement.readings([distances_of(measurement, session)], theta)
        assert rms_mm(read - session.distances) == pytest.approx(distances, abs=1e-6)


KINDS = ("probe", "calliper")
PREDICTED = [(seen, unseen, kind) for seen, unseen in published.ASKED for kind in KINDS]


def held_out(m: Measurement, session: Session, kind: str) -> tuple[Series, np.ndarray]:
    """Poses and readings of one kind."""
    if kind == "probe":
        return heights_of(m, session), session.heights
    return distances_of(m, session), session.distances


def without_bed(n: int, kind: str) -> np.ndarray:
    """Takes the bed's height, free in each session, out of n readings."""
    return np.eye(n) - (1 / n if kind == "probe" else 0.0)


def miss_of(
    m: Measurement, theta: np.ndarray, session: Session, kind: str
) -> np.ndarray:
    """Readings less their prediction."""
    series, read = held_out(m, session, kind)
    return without_bed(len(read), kind) @ (read - m.readings([series], theta))


@pytest.mark.parametrize(("seen", "unseen", "kind"), PREDICTED)
def test_a_prediction_is_as_near_as_asked(measurement, sessions, seen, unseen, kind):
    estimate = fitted(measurement, sessions[seen])
    miss = miss_of(measurement, estimate.theta, sessions[unseen], kind)
    assert rms_mm(miss) <= published.ASKED[seen, unseen][KINDS.index(kind)]


@pytest.mark.parametrize(("seen", "unseen"), published.ASKED)
def test_one_session_predicts_another(measurement, sessions, seen, unseen):
    """Held-out readings, and how many of them the 95 % intervals hold; the bed's height
    is free in each session.
    """
    estimate, other = fitted(measurement, sessions[seen]), sessions[unseen]
    inside = []
    for kind, ordinary in zip(KINDS, published.ORDINARY[seen, unseen], strict=True):
        series, read = held_out(measurement, other, kind)
        n = len(read)
        miss = miss_of(measurement, estimate.theta, other, kind)
        h = measurement.jacobian([series], estimate.theta)
        sigma = np.full(n, estimate.noise.sigma[0 if kind == "probe" else -1])
        covariance = h @ estimate.covariance @ h.T + np.diag(sigma**2)
        bed = without_bed(n, kind)
        spread = bed @ covariance @ bed
        inside += (np.abs(miss) < 1.96 * np.sqrt(np.diag(spread))).tolist()
        assert rms_mm(miss) == pytest.approx(ordinary, rel=0.1)
    assert len(inside) == 19
    assert 0.85 <= np.mean(inside) <= 1.0


def test_nominal_geometry_is_worse(measurement, sessions):
    low, high = published.NOMINAL_DISTANCES
    for name in ("S03", "S04"):
        read = measurement.readings(
            [distances_of(measurement, sessions[name])], measurement.nominal
        )
        assert low - 0.005 < rms_mm(read - sessions[name].distances) < high + 0.005


def test_heights_alone_cannot_tell_the_arms(measurement, sessions):
    """Seven contacts: rank 7, said before any fit, with all arms in what is lost.
    Distances bring all but the bed.
    """
    m, session = measurement, sessions["S04"]

    def verdict(series: list[Series], *unknowns: str) -> Identifiability:
        names = [n for n in m.names[:10] if n != "angle3"] + list(unknowns)
        columns = [m.names.index(n) for n in names]
        scale = 1 / m.length_factors[columns]
        return analyse(m.jacobian(series, m.nominal)[:, columns] * scale, names, scale)

    alone = verdict([heights_of(m, session)], "S04_probe.offset")
    assert (alone.rank, len(alone.names)) == (7, 10)
    assert all(
        any(arm in direction for direction in alone.coefficients_by_name(alone.lost))
        for arm in ARMS
    )
    unit = np.eye(10)[[alone.names.index(arm) for arm in ARMS]]
    assert np.linalg.norm(unit @ alone.null_space.T, axis=1).min() > 0.1
    both = verdict(
        [heights_of(m, session), distances_of(m, session)], "S04_probe.offset"
    )
    assert both.rank == 9
    assert [set(direction) for direction in both.coefficients_by_name(both.lost)] == [
        {"endstop1", "endstop2", "endstop3", "S04_probe.offset"}
    ]
    found = identify(m, [heights_of(m, session)], session.heights, estimate_noise=True)
    other = sessions["S03"]
    miss = rms_mm(m.readings([distances_of(m, other)], found.theta) - other.distances)
    low, high = published.HEIGHTS_ALONE
    assert low < miss < high


def test_the_arms_stay_wide_and_are_said_to(measurement, sessions):
    """Both sessions leave more than 0.4 mm of the arms' 1 mm open, and agree within it."""
    found = {name: fitted(measurement, sessions[name]) for name in ("S03", "S04")}
    arms = [measurement.names.index(arm) for arm in ARMS]
    for estimate in found.values():
        assert (estimate.sd[arms] > 0.4 * MM).all()
        assert all(any(arm in told for told in estimate.warnings) for arm in ARMS)
    apart = found["S03"].theta - found["S04"].theta
    assert (
        np.abs(apart[arms]) < 2 * np.hypot(found["S03"].sd, found["S04"].sd)[arms]
    ).all()


@pytest.mark.parametrize("name", ["delta_v400", "delta_v400_reverse"])
def test_the_study_reads_the_same_readings(sessions, name):
    """Its data against the tables as read here: joints, pairs and values, reading by reading."""
    resolved = resolve.resolve(
        study.Study.load(ROOT / "studies" / f"{name}.study.toml")
    )
    data = resolved.dataset
    assert set(data.setups) == {
        f"{s}_{kind}" for s in ("S03", "S04") for kind in ("probe", "calliper")
    }
    assert data.dropped == 0
    for series in data.series:
        session, kind = series.setup.split("_")
        read, mine = data.take([series.setup]).y, sessions[session]
        if kind == "probe":
            assert series.q[series.index[:, 0]] == pytest.approx(
                mine.contacts, abs=1e-12
            )
            assert read == pytest.approx(mine.heights, abs=1e-12)
        else:
            assert series.q[series.index[:, ::-1]] == pytest.approx(
                mine.pairs, abs=1e-12
            )
            assert read == pytest.approx(mine.distances, abs=1e-12)
