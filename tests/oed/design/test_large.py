"""Candidates on disk beside the same in memory; bounds beside all slopes."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from oed.design import choose, choose_from_file, large, open_candidates
from oed.design.large import NumpyCandidates

SMALL = {"CANDIDATES_AT_ONCE": 700, "SAMPLE_SIZE": 400, "STEEPEST_SIZE": 500}


def _write(folder: Path, rows: np.ndarray) -> Path:
    path = folder / "rows.npy"
    np.save(path, rows)
    return path


@pytest.mark.parametrize(
    ("kind", "criterion"),
    [("normal", "D"), ("normal", "A"), ("ill", "D"), ("lost", "D"), ("blocks", "D")],
)
def test_as_in_memory(tmp_path: Path, kind: str, criterion: str) -> None:
    rng = np.random.default_rng(3)
    shape = (4000, 2, 6) if kind == "blocks" else (4000, 6)
    rows = rng.standard_normal(shape)
    if kind == "ill":
        rows = rows * np.logspace(0.0, -5.0, 6)
    if kind == "lost":
        rows[:, 5] = rows[:, 0] - rows[:, 1]
    source = open_candidates(_write(tmp_path, rows))
    with mock.patch.multiple(large, **SMALL):
        on_disk = choose_from_file(source, 12, np.random.default_rng(1), criterion)
    in_memory = choose(rows, 12, np.random.default_rng(1), criterion)
    assert on_disk.indices.tolist() == in_memory.indices.tolist()
    assert on_disk.value == pytest.approx(in_memory.value, rel=1e-9)
    assert on_disk.bound == pytest.approx(in_memory.bound, rel=1e-6)
    assert on_disk.directions == in_memory.directions
    assert on_disk.columns == in_memory.columns
    assert on_disk.duality_gap is not None
    assert 0.0 < on_disk.duality_gap < 1e-6


def test_the_bound_holds_where_the_sample_misleads(tmp_path: Path) -> None:
    """Good candidates at places that the sample has not: no plan of them is above."""
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((5000, 4))
    rows[3333:3340] *= 30.0
    source = NumpyCandidates(_write(tmp_path, rows))
    with mock.patch.multiple(large, **SMALL):
        design = choose_from_file(source, 6, np.random.default_rng(1))
    assert set(design.indices) <= set(range(3333, 3340))
    assert design.bound is not None
    best = max(
        np.linalg.slogdet(
            np.delete(rows[3333:3340], k, axis=0).T
            @ np.delete(rows[3333:3340], k, axis=0)
        )[1]
        for k in range(7)
    )
    assert design.value == pytest.approx(best)
    assert design.bound >= best


def test_single_precision_and_a_prior(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((3000, 5)).astype(np.float32)
    prior = np.diag([4.0, 0.0, 0.0, 1.0, 0.0])
    mapped = np.load(_write(tmp_path, rows), mmap_mode="r")
    with mock.patch.multiple(large, **SMALL):
        on_disk = choose(mapped, 9, np.random.default_rng(1), prior=prior)
    exact = rows.astype(float)
    in_memory = choose(exact, 9, np.random.default_rng(1), prior=prior)
    assert on_disk.indices.tolist() == in_memory.indices.tolist()
    assert on_disk.bound == pytest.approx(in_memory.bound, abs=1e-6)


def test_a_slice_of_a_mapped_array(tmp_path: Path) -> None:
    rows = np.random.default_rng(8).standard_normal((900, 2, 3))
    mapped = np.load(_write(tmp_path, rows), mmap_mode="r")
    for part, exact in ((mapped, rows), (mapped[100:], rows[100:])):
        source = NumpyCandidates(part)
        assert np.array_equal(source.read(40, 90), exact[40:90])
        assert np.array_equal(source.take(np.array([7, 3])), exact[[7, 3]])


def test_an_arrow_file(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    rows = np.random.default_rng(6).standard_normal((2500, 3))
    table = arrow.table({f"p{k}": rows[:, k] for k in range(3)})
    path = tmp_path / "rows.arrow"
    with arrow.ipc.new_file(str(path), table.schema) as writer:
        writer.write_table(table, max_chunksize=600)
    source = open_candidates(path)
    with mock.patch.multiple(large, **SMALL):
        on_disk = choose_from_file(source, 5, np.random.default_rng(1))
    in_memory = choose(rows, 5, np.random.default_rng(1))
    assert on_disk.indices.tolist() == in_memory.indices.tolist()


def test_what_is_refused(tmp_path: Path) -> None:
    rows = np.random.default_rng(7).standard_normal((2000, 3))
    rows[1234, 1] = np.nan
    source = open_candidates(_write(tmp_path, rows))
    rng = np.random.default_rng(1)
    with mock.patch.multiple(large, **SMALL):
        with pytest.raises(ValueError, match=r"number \[1234\] are not finite"):
            choose_from_file(source, 5, rng)
        rows[1234, 1] = 0.0
        source = open_candidates(_write(tmp_path, rows))
        with pytest.raises(ValueError, match="E needs its candidates in memory"):
            choose_from_file(source, 5, rng, "E")
    with pytest.raises(ValueError, match="floating-point"):
        open_candidates(_write(tmp_path, rows.astype(int)))
    with pytest.raises(ValueError, match=r"read from \.npy"):
        open_candidates(tmp_path / "rows.csv")
