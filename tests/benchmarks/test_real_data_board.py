"""Boards of real machines and long traces: baselines, memory and answers."""

import pytest

from benchmarks.harness.processes import alone
from benchmarks.long_traces import diagnose_once
from benchmarks.real_data import ENTRIES, STUDIES, line, run
from pkm_studies.plugins import project_plugins
from pkm_studies.study.data_sources import jugglebot


@pytest.mark.slow
def test_an_entry_runs(shared_data, tmp_path):
    """The data's SOURCE.txt: 0.056 and 0.075 mm by least squares, 0.39 and 0.25 nominal."""
    if not (shared_data / "delta_v400").is_dir():
        pytest.skip("the folder delta_v400 with real measurements is not there")
    heights, lengths = run(ENTRIES[0], shared_data, tmp_path)
    assert heights.least_squares == pytest.approx(56.0, rel=0.1)
    assert lengths.least_squares == pytest.approx(75.0, rel=0.1)
    assert heights.nominal == pytest.approx(390.0, rel=0.05)
    assert 245.0 < lengths.nominal < 305.0
    assert heights.blind.rms < 60.0
    assert f"| {heights.blind.rms:.3g} um |" in line(ENTRIES[0], heights)


def test_entries_name_what_is_there():
    for entry in ENTRIES:
        assert bool(entry.study) != bool(entry.file)
        if entry.study:
            assert (STUDIES / f"{entry.study}.study.toml").is_file()
            assert entry.folder in project_plugins("sources")
    assert len({entry.name for entry in ENTRIES}) == len(ENTRIES)


def test_quaternions_become_the_angles_of_the_tracker(shared_data):
    from scipy.spatial.transform import Rotation

    folder = shared_data / "jugglebot"
    if not folder.is_dir():
        pytest.skip("the folder jugglebot with real measurements is not there")
    rows = list(jugglebot.rows(folder))
    assert [row["setup"] for row in rows[:2]] == ["fit", "blind"]
    text = (folder / "poses_108.csv").read_text("utf-8").splitlines()
    for row, row_text in zip(rows, text[1:], strict=True):
        rotation = Rotation.from_quat([float(v) for v in row_text.split(",")[-4:]])
        angles = rotation.as_euler("XYZ", degrees=True)
        names = ("alpha", "beta", "gamma")
        read = [float(row[f"read_{name}_deg"]) for name in names]
        assert read == pytest.approx(angles, abs=1e-9)
    # 1.6767652 revolutions at 13.21144 a metre, from the design's lowest height
    assert float(rows[0]["q1_mm"]) == pytest.approx(640.1966 + 126.9176, abs=1e-3)


MOST = 2048.0  #: most memory of a process, MiB, with Python and all libraries


@pytest.mark.slow
@pytest.mark.parametrize("readings", [5000, 20000])
@pytest.mark.parametrize(("gap", "answer"), [(True, "backlash"), (False, "no gap")])
def test_a_diagnosis_of_long_traces_fits_into_memory(readings, gap, answer):
    diagnosed = alone(diagnose_once, readings, gap)
    assert diagnosed.memory < MOST
    assert diagnosed.answer.startswith(answer)
