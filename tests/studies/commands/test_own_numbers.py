"""A user's own numbers: a CSV and a machine's name, against machines of NumPy and SciPy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from pkm_studies import stages
from pkm_studies.base import InputError
from pkm_studies.commands.own_numbers import calibration_answer, import_numbers
from pkm_studies.study import Study
from pkm_studies.user_code import Consent

Array = np.ndarray
#: mm, anchors as the user has them, and as they are
ANCHORS = np.array([[-1500.0, -1000], [1500, -1000], [1500, 1000], [-1500, 1000]])
SHIFT = np.array([[0.0, 0], [45, 0], [-30, 35], [20, -40]])
ANCHOR_TEXT = f"anchor_mm={ANCHORS.tolist()}"
PLACES = np.array(
    [[x, y] for x in (-700, 0, 700) for y in (-450, 0, 450)] + [[300, 150]]
)
#: without posterior and effects, which take seconds
QUICK = '\n[posterior]\nenabled = false\n\n[identify]\neffects = "none"\n'
#: what distances of twenty holes do not tell from each other
DELTA_FIXED = 'fixed = ["arm*", "angle*", "setup1.scale"]\n'


def settled(lengths: Array, anchors: Array, start: Array) -> Array:
    """Where four belts of these lengths hold the sled, mm."""
    fit = least_squares(lambda x: np.linalg.norm(x - anchors, axis=1) - lengths, start)
    return np.asarray(fit.x)


def reached(commands: Array, believed: Array, anchors: Array) -> Array:
    lengths = np.linalg.norm(commands[:, None] - believed, axis=2)
    return np.array(
        [settled(q, anchors, c) for q, c in zip(lengths, commands, strict=True)]
    )


def rms_after_alignment(points: Array, wanted: Array) -> float:
    """Rms error a coordinate once the sheet is laid on as well as it can be, mm."""
    a, b = points - points.mean(axis=0), wanted - wanted.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    return float(np.sqrt(np.mean((a @ u @ v - b) ** 2)))


def write(path: Path, header: str, rows: Array) -> Path:
    lines = [";".join(f"{value:.2f}" for value in row) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def answered(
    file: Path, machine: str, *numbers: str, fixed: str = ""
) -> tuple[str, str, dict[str, float]]:
    """Judgement, sentence and the parameters, mm, without posterior and effects."""
    folder = file.with_suffix("")
    study, _ = import_numbers(machine, numbers, [file], folder, Consent.RECORDED)
    text = study.read_text().replace("[machine]\n", f"[machine]\n{fixed}")
    study.write_text(text + QUICK)
    loaded = Study.load(study)
    result = stages.run_study(loaded, folder / "fit", report=False)
    sentence = calibration_answer(loaded, result, folder / "fit")
    judgement = sentence.removeprefix("Is the calibration good? ").partition(":")[0]
    values = {n: p.value for n, p in result.estimate.parameters.items()}
    return judgement, sentence, values


def test_twenty_measured_positions_of_four_belts(tmp_path):
    true = ANCHORS + SHIFT
    rng = np.random.default_rng(2)
    read = reached(PLACES, ANCHORS, true) + rng.normal(0.0, 0.5, PLACES.shape)
    file = write(
        tmp_path / "sheet.csv", "X;Y;X measured;Y measured", np.c_[PLACES, read]
    )
    judgement, sentence, values = answered(file, "cables_planar", ANCHOR_TEXT)
    assert judgement == "No", sentence
    anchors = np.array(
        [[values[f"anchor{k}{axis}"] for axis in "xy"] for k in (1, 2, 3, 4)]
    )
    grid = np.array([[x, y] for x in (-600, -200, 250, 650) for y in (-400, 100, 400)])
    before = rms_after_alignment(reached(grid, ANCHORS, true), grid)
    after = rms_after_alignment(reached(grid, anchors, true), grid)
    assert before > 2.0
    assert after < 0.6, (before, after)  # the noise, a coordinate: 0.5


def test_a_guessed_noise_that_is_far_too_large_brings_no_effect(tmp_path):
    """Positions to 5 um, where half a millimetre is assumed of a tool with no name."""
    rng = np.random.default_rng(6)
    places = np.array([[x, y] for x in range(-700, 701, 200) for y in (-450, 0, 450)])
    read = reached(places, ANCHORS, ANCHORS + 0.1 * SHIFT)
    read = np.vstack([read, read]) + rng.normal(0.0, 5e-3, (48, 2))
    rows = np.c_[np.vstack([places, places]), read]
    file = tmp_path / "sheet.csv"
    lines = [",".join(f"{value:.5f}" for value in row) for row in rows]
    file.write_text("\n".join(["x,y,measured x,measured y", *lines]) + "\n")
    folder = tmp_path / "study"
    study, _ = import_numbers(
        "cables_planar", (ANCHOR_TEXT,), [file], folder, Consent.RECORDED
    )
    study.write_text(study.read_text() + "\n[posterior]\nenabled = false\n")
    gap = stages.run_study(Study.load(study), folder / "fit", report=False).gap
    assert gap.verdict == "none"
    assert max(gap.rms_before.values()) < 8.0
    assert gap.noise[0].endswith("times the noise of the fit")


def test_numbers_that_are_right(tmp_path):
    rng = np.random.default_rng(4)
    read = PLACES + rng.normal(0.0, 0.5, PLACES.shape)
    file = write(tmp_path / "sheet.csv", "x;y;actual x;actual y", np.c_[PLACES, read])
    judgement, sentence, _ = answered(file, "cables_planar", ANCHOR_TEXT)
    assert judgement == "Yes", sentence


def test_belts_alone_by_their_corners(tmp_path):
    """As SciPy fits them, the lower left anchor the origin and the lower right one on x.

    The frame counts from a corner, and the columns are in another order than the cables.
    """
    origin = ANCHORS[0]
    order = [3, 2, 0, 1]
    rng = np.random.default_rng(3)
    belts = np.linalg.norm(PLACES[:, None] - (ANCHORS + SHIFT), axis=2)
    belts = (belts + rng.normal(0.0, 0.5, belts.shape)).round(2)
    file = write(tmp_path / "belts.csv", "tl;tr;bl (mm);br", belts[:, order])
    anchors = f"anchor_mm={(ANCHORS - origin).tolist()}"
    _, sentence, values = answered(file, "cables_planar", anchors)
    assert "Is the calibration good?" in sentence

    def gaps(v: Array) -> Array:
        corners = np.array([[0.0, 0.0], [v[0], 0.0], v[1:3], v[3:5]])
        apart = v[5:].reshape(-1, 1, 2) - corners
        return np.asarray((np.linalg.norm(apart, axis=2) - belts).ravel())

    start = np.r_[3000.0, 3000.0, 2000.0, 0.0, 2000.0, (PLACES - origin).ravel()]
    wanted = least_squares(gaps, start).x[:5]
    found = np.array(
        [[values[f"anchor{k}{axis}"] for axis in "xy"] for k in (1, 2, 3, 4)]
    )
    found -= found[0]
    c, s = found[1] / np.hypot(*found[1])
    found = found @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose([found[1, 0], *found[2], *found[3]], wanted, atol=1.5)


def delta_joints(points: Array, radius: float, arm: float, endstop: Array) -> Array:
    """Travel (n, 3), mm, of a delta's carriages down from their endstops."""
    angle = np.radians([210, 330, 90])
    towers = radius * np.c_[np.cos(angle), np.sin(angle)]
    flat = ((points[:, None, :2] - towers) ** 2).sum(axis=2)
    top = endstop + np.sqrt(arm**2 - radius**2)
    return np.asarray(top - points[:, 2:] - np.sqrt(arm**2 - flat))


def delta_points(commands: Array, now: tuple, true: tuple) -> Array:
    joints = delta_joints(commands, *now)
    return np.array(
        [
            least_squares(
                lambda x, q=q: delta_joints(x[None], *true)[0] - q, c, xtol=1e-14
            ).x
            for q, c in zip(joints, commands, strict=True)
        ]
    )


def test_twenty_distances_of_a_delta(tmp_path):
    """Radius and differences of endstops as SciPy fits them to the same distances."""
    now = (125.0, 250.0, np.full(3, 300.0))
    true = (126.2, 250.0, np.array([300.4, 300.0, 299.8]))
    turn = np.radians(np.arange(0, 360, 60))
    flat = np.array([[r * np.cos(a), r * np.sin(a)] for r in (40, 80) for a in turn])
    commands = np.vstack([np.zeros(3), np.c_[flat, np.zeros(12)]]).round(2)
    pairs = [(0, k) for k in range(1, 13)]
    pairs += [(7, 10), (8, 11), (9, 12), (7, 9), (8, 10), (9, 11), (10, 12), (7, 11)]
    first, second = np.array(pairs).T

    def distances(numbers: Array) -> Array:
        points = delta_points(commands, now, (numbers[0], 250.0, numbers[1:]))
        return np.asarray(np.linalg.norm(points[first] - points[second], axis=1))

    noise = np.random.default_rng(5).normal(0.0, 0.02, len(pairs))
    read = (distances(np.array([true[0], *true[2]])) + noise).round(2)
    rows = np.c_[commands[first], commands[second], read]
    file = write(tmp_path / "holes.csv", "x1;y1;z1;x2;y2;z2;distance", rows)
    numbers = ["radius_mm=125"]
    numbers += [
        f"{name}{k}_mm={v}"
        for name, v in (("arm", 250), ("endstop", 300))
        for k in (1, 2, 3)
    ]
    judgement, sentence, values = answered(
        file, "linear_delta", *numbers, fixed=DELTA_FIXED
    )
    assert judgement == "No", sentence
    start = np.array([now[0], *now[2]])
    weak = lambda v: (v[1:].mean() - 300.0) * 1e-4  # no distance sees it  # noqa: E731
    fit = least_squares(
        lambda v: [*(distances(v) - read), weak(v)], start, diff_step=1e-5
    )
    ends = np.array([values[f"endstop{k}"] for k in (1, 2, 3)])
    np.testing.assert_allclose(values["radius"], fit.x[0], atol=0.03)
    np.testing.assert_allclose(
        ends - ends.mean(), fit.x[1:] - fit.x[1:].mean(), atol=0.01
    )
    assert abs(fit.x[0] - true[0]) < 0.2


@pytest.mark.parametrize(("header", "rows", "reason"), [
    ("x;y;wobble", 3, r"header = wobble: no quantity of this machine"),
    ("x (deg);y;x measured", 3, r"header = x \(deg\): no quantity"),
    ("x;y", 2, "nothing was measured"),
    ("x;y;distance", 3, "header = distance: a distance between which two places"),
])  # fmt: skip
def test_words_that_are_not_read(header, rows, reason, tmp_path):
    file = write(tmp_path / "own.csv", header, np.ones((5, rows)))
    with pytest.raises(InputError, match=reason):
        import_numbers("cables_planar", [], [file], tmp_path / "f", Consent.RECORDED)
    assert not (tmp_path / "f").exists() or not list((tmp_path / "f").glob("*.toml"))


def test_the_command_says_what_it_lacks(tmp_path, oed):
    file = write(tmp_path / "a.csv", "x;y;x measured;y measured", np.ones((5, 4)))
    code, _, error = oed("identify", "--readings", file, "--out", tmp_path / "o")
    assert code == 2
    assert "--machine NAME" in error
    wrong = ("--machine", "cables_planar", "--set", "anchor_mm=left")
    code, _, error = oed(
        "identify", *wrong, "--readings", file, "--out", tmp_path / "o"
    )
    assert code == 2
    assert "--set: this is no TOML" in error
