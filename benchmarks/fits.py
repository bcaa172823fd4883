"""Processor time and peak memory of commands on 162 readings of a user's own machines.

    python -m benchmarks.fits

`cranks` is `oed diagnose` of a hexapod on six cranks, `cables` is `oed identify` of a body
on eight cables. A tracker reads three nests at 18 poses each, simulated with plain NumPy:
errors of all joints, noise, play in the first crank or cable. One BLAS thread.
"""

import functools
import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.harness.processes import alone, peak
from benchmarks.harness.tables import head, row
from pkm_studies import commands

COMMANDS = {"cranks": "diagnose", "cables": "identify"}
HEIGHT, REACH = {"cranks": 400.0, "cables": 1000.0}, {"cranks": 40.0, "cables": 220.0}
PLAY = {"cranks": 0.2e-3, "cables": 0.02}  # half of it, rad or mm
TILT, CRANK, STRUT, JOINT_SD, NOISE = 6.0, 100.0, 420.0, 0.15, 0.01  # deg, mm
COLUMNS = (
    "setup,run,order,x_mm,y_mm,z_mm,rx_deg,ry_deg,spin_deg,time_s,"
    "read_x_mm,read_y_mm,read_z_mm"
)
NESTS = np.array([[150.0, 0.0, 30.0], [-75.0, 130.0, 30.0], [-75.0, -130.0, 30.0]])
ANGLES = np.radians([-18, 18, 102, 138, 222, 258])
OUTWARD = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES])
UP = np.array([0.0, 0.0, 1.0])
ASIDE = np.cross(OUTWARD, UP)
CORNERS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(8, 3)
X, Y, Z = CORNERS.T
#: points of the base and of the moving body, mm
BASE = {"cranks": 300.0 * OUTWARD, "cables": CORNERS * [1500, 1200, 1000] + 1000 * UP}
TURNED = np.tile([70.0, -70.0], 3)[:, None] * ASIDE
ENDS = {
    "cranks": 165.0 * OUTWARD + TURNED - 20.0 * UP,
    "cables": np.column_stack([96 * X + 207 * Y * Z, 263 * X * Z - 75 * Y, -180 * Z]),
}
MODEL = {
    "cranks": f"""model = "hexapod_rus"
[machine.geometry]
centre_mm = {BASE["cranks"].tolist()}
first = {OUTWARD.tolist()}
axis = {ASIDE.tolist()}
crank_mm = {CRANK}
strut_mm = {STRUT}
platform_mm = {ENDS["cranks"].tolist()}
reach_mm = 80
tilt_deg = 12""",
    "cables": f"""model = "cables_spatial"
[machine.geometry]
anchor_mm = {BASE["cables"].tolist()}
attach_mm = {ENDS["cables"].tolist()}""",
}
STUDY = """schema = 1\nname = "fits"\nseed = 1\n[machine]\n{0}
home_mm = [0, 0, {1}]\ntolerance_mm = {2}\n{3}[posterior]\nenabled = false
[prediction]\nx_mm = [-{4}, {4}]\ny_mm = [-{4}, {4}]\nz_mm = {1}
rx_deg = [-5, 5]\nry_deg = [-5, 5]\nspin_deg = 0\n"""
NEST = """[[setup]]\nname = "nest{}"\ninstrument = "pose_tracker_position"\ntool_mm = {}\n"""


def rotation(rx: float, ry: float, spin: float) -> np.ndarray:
    """The spin about z, then a tilt by the rotation vector (rx, ry, 0); deg."""
    rx, ry, spin = np.radians([rx, ry, spin])
    cross = np.array([[0.0, 0.0, ry], [0.0, 0.0, -rx], [-ry, rx, 0.0]])
    turns, c, s = np.hypot(rx, ry) / np.pi, np.cos(spin), np.sin(spin)
    tilt = np.eye(3) + np.sinc(turns) * cross
    tilt += 0.5 * np.sinc(turns / 2.0) ** 2 * cross @ cross
    return tilt @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def misfit(job: str, points: tuple, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """What each strut or cable is too long, mm, at pose x (6,) and joints q (n,)."""
    (base, ends), wanted = points, q
    if job == "cranks":
        arm = np.cos(q)[:, None] * OUTWARD + np.sin(q)[:, None] * UP
        base, wanted = base + CRANK * arm, STRUT
    strut = x[:3] + ends @ rotation(*x[3:]).T - base
    return np.linalg.norm(strut, axis=1) - wanted


def solved(function, z: np.ndarray) -> np.ndarray:
    """Where a function vanishes, or its squares are least, by Gauss-Newton steps."""
    for _ in range(12):
        steps = 1e-5 * np.eye(len(z))
        slopes = [(function(z + d) - function(z - d)) / 2e-5 for d in steps]
        z = z - np.linalg.lstsq(np.array(slopes).T, function(z))[0]
    return z


def write(job: str, study: Path, readings: Path) -> None:
    """A study and its readings."""
    rng, last, drawn = np.random.default_rng(7), 0.0, (BASE[job], ENDS[job])
    real = [p + JOINT_SD * rng.standard_normal(p.shape) for p in drawn]
    rows = [COLUMNS]
    for k in range(54):
        pose = rng.uniform(-1.0, 1.0, 6) * ([REACH[job]] * 3 + [TILT] * 3)
        pose[2] += HEIGHT[job]
        start = np.full(len(real[0]), 0.3 if job == "cranks" else 1000.0)
        q = solved(functools.partial(misfit, job, drawn, pose), start)
        sense, last = np.sign(q[0] - last), q[0]
        q[0] += sense * PLAY[job]
        reached = solved(lambda x, q=q: misfit(job, real, x, q), pose)
        tips = [x[:3] + rotation(*x[3:]) @ NESTS[k // 18] for x in (pose, reached)]
        noise = NOISE * rng.standard_normal(3)
        values = [*tips[0], *pose[3:], 20 * k, *(tips[1] + noise)]
        rows.append(f"nest{k // 18},{k // 6},{k}," + ",".join(map(str, values)))
    readings.write_text("\n".join(rows), encoding="utf-8")
    nests = "".join(NEST.format(k, nest) for k, nest in enumerate(NESTS.tolist()))
    text = STUDY.format(MODEL[job], HEIGHT[job], JOINT_SD, nests, REACH[job])
    study.write_text(text, encoding="utf-8")


def measured(job: str) -> tuple[float, float]:
    """Processor time, s, and peak memory, MiB, of a job's command."""
    with tempfile.TemporaryDirectory() as folder:
        study, readings = Path(folder, "fits.study.toml"), Path(folder, "readings.csv")
        write(job, study, readings)
        files = [str(study), "--readings", str(readings), "--out", f"{folder}/out"]
        start = time.process_time()
        commands.main([COMMANDS[job], *files, "--quiet"])
    return time.process_time() - start, peak() / 2**20


if __name__ == "__main__":
    print(head("machine", "command", "s", "MiB"), flush=True)
    for job, command in COMMANDS.items():
        seconds, memory = alone(measured, job)
        print(row(job, command, f"{seconds:.1f}", f"{memory:.0f}"), flush=True)
