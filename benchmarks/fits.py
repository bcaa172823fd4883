"""Processor time and peak memory of whole commands: 162 readings, machines of a user's own.

    python -m benchmarks.fits

`cranks` is `oed diagnose` of a hexapod on six cranks, `cables` is `oed identify` of a body
on eight cables. A tracker reads three nests at 18 poses each, simulated with plain NumPy:
errors of all joints, white noise, play in the first crank or cable. One BLAS thread.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pkm_studies import commands

COMMANDS = {"cranks": "diagnose", "cables": "identify"}
HEIGHT, REACH = {"cranks": 400.0, "cables": 1000.0}, {"cranks": 40.0, "cables": 220.0}
TILT, CRANK, STRUT, JOINT_SD, NOISE, PLAY = 0.1, 100.0, 420.0, 0.15, 0.012, 0.04
NESTS = np.array([[150.0, 0.0, 30.0], [-75.0, 130.0, 30.0], [-75.0, -130.0, 30.0]])
HEADER = "setup,run,order,x_mm,y_mm,z_mm,rx_rad,ry_rad,spin_rad,time_s,direction"
ANGLES = np.radians([-18, 18, 102, 138, 222, 258])
OUTWARD = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES])
UP = np.array([0.0, 0.0, 1.0])
CORNERS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(8, 3)
#: points of the base and of the moving body, mm
BASE = {"cranks": 300.0 * OUTWARD, "cables": CORNERS * [1500, 1200, 1000] + 1000 * UP}
ENDS = {
    "cranks": 180.0 * OUTWARD
    + 70.0 * np.tile([1, -1], 3)[:, None] * np.cross(OUTWARD, UP),
    "cables": CORNERS * [280.0, -220.0, -180.0],
}
STUDY = {
    "cranks": f"""model = "hexapod_rus"
[machine.geometry]
centre_mm = {BASE["cranks"].tolist()}
first = {OUTWARD.tolist()}
axis = {np.cross(OUTWARD, UP).tolist()}
crank_mm = {CRANK}
strut_mm = {STRUT}
platform_mm = {ENDS["cranks"].tolist()}
reach_mm = 80
tilt_deg = 12""",
    "cables": f"""model = "cables_spatial"
[machine.geometry]
anchor_mm = {BASE["cables"].tolist()}
attach_mm = {ENDS["cables"].tolist()}
reach_mm = 600
turn_deg = 12""",
}


def rotation(rx: float, ry: float, spin: float) -> np.ndarray:
    """The spin about z, then a tilt by the rotation vector (rx, ry, 0)."""
    cross = np.array([[0.0, 0.0, ry], [0.0, 0.0, -rx], [-ry, rx, 0.0]])
    turns, c, s = np.hypot(rx, ry) / np.pi, np.cos(spin), np.sin(spin)
    tilt = np.eye(3) + np.sinc(turns) * cross
    tilt += 0.5 * np.sinc(turns / 2.0) ** 2 * cross @ cross
    return tilt @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def misfit(job: str, x: np.ndarray, q: np.ndarray, base: np.ndarray, ends: np.ndarray):
    """What each strut or cable is too long (n,), mm, at a pose x (6,) and joints (n,)."""
    strut, wanted = x[:3] + ends @ rotation(*x[3:]).T - base, q
    if job == "cranks":
        arm = np.cos(q)[:, None] * OUTWARD + np.sin(q)[:, None] * UP
        strut, wanted = strut - CRANK * arm, STRUT
    return np.linalg.norm(strut, axis=1) - wanted


def solved(function, z: np.ndarray) -> np.ndarray:
    """Where a function vanishes, or its squares are least, by Gauss-Newton steps."""
    for _ in range(12):
        steps = 1e-6 * np.eye(len(z))
        slopes = [(function(z + d) - function(z - d)) / 2e-6 for d in steps]
        z = z - np.linalg.lstsq(np.array(slopes).T, function(z))[0]
    return z


def write(job: str, study: Path, readings: Path) -> None:
    """A study and its readings."""
    rng, drawn, last = np.random.default_rng(7), (BASE[job], ENDS[job]), 0.0
    real = [p + JOINT_SD * rng.standard_normal(p.shape) for p in drawn]
    rows = [f"{HEADER},read_x_mm,read_y_mm,read_z_mm"]
    for k in range(54):
        pose = rng.uniform(-1.0, 1.0, 6) * ([REACH[job]] * 3 + [TILT] * 3)
        pose[2] += HEIGHT[job]
        q = solved(lambda q: misfit(job, pose, q, *drawn), np.full(len(real[0]), 0.3))
        moved = q + 0.5 * PLAY * np.sign(q[0] - last) * (np.arange(len(q)) == 0)
        if job == "cranks":
            moved = q + (moved - q) / CRANK
        last = q[0]
        reached = solved(lambda x: misfit(job, x, moved, *real), pose)
        command, read = (
            x[:3] + rotation(*x[3:]) @ NESTS[k // 18] for x in (pose, reached)
        )
        values = [*command, *pose[3:], 20 * k, (-1) ** (k // 6)]
        values += [*(read + NOISE * rng.standard_normal(3))]
        rows.append(f"nest{k // 18},{k // 6},{k},{','.join(map(str, values))}")
    readings.write_text("\n".join(rows), encoding="utf-8")
    text = f"""schema = 1\nname = "fits"\nseed = 1\n[machine]\n{STUDY[job]}
home_mm = [0, 0, {HEIGHT[job]}]\ntolerance_mm = {JOINT_SD}\n"""
    for k, nest in enumerate(NESTS.tolist()):
        text += f"""[[setup]]\nname = "nest{k}"\ninstrument = "pose_tracker_position"
tool_mm = {nest}\n"""
    noise = "".join(f"read_{axis}_um = {1e3 * NOISE}\n" for axis in "xyz")
    places = "".join(f"{axis}_mm = [{-REACH[job]}, {REACH[job]}]\n" for axis in "xy")
    text += f"""[noise]\n{noise}[posterior]\nenabled = false\n[prediction]\n{places}
z_mm = {HEIGHT[job]}\nrx_deg = [-5, 5]\nry_deg = [-5, 5]\nspin_deg = 0\n"""
    study.write_text(text, encoding="utf-8")


if len(sys.argv) < 2:
    print("| machine | command | s | MiB |\n| --- | --- | --: | --: |", flush=True)
    for name in COMMANDS:
        subprocess.run([sys.executable, "-m", "benchmarks.fits", name], check=True)
else:
    job = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder, "fits.study.toml"), Path(folder, "readings.csv")
        write(job, *files)
        start, arguments = (
            time.process_time(),
            [COMMANDS[job], str(files[0]), "--quiet"],
        )
        commands.main(
            [*arguments, "--readings", str(files[1]), "--out", f"{folder}/out"]
        )
    seconds = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"| {job} | {COMMANDS[job]} | {seconds:.1f} | {memory:.0f} |")
