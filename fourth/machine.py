"""Three machines of my own: a rotary delta, three cranks that slide a plate, three winches.

rotary3: |t - k_i| = lo_i, knee k_i = (rad_i + up_i cos(q_i + zero_i)) out_i + (hgt_i - up_i sin(q_i + zero_i)) z
slide3:  |A_i - E_i| = rod_i as in the tutorial
hang3:   |t - A_i| = l0_i + len_i + drum_i q_i, a load on three cables from drums
"""
import math
import casadi as ca
from oed import Component, Coordinate, Machine, Parameter
LIMBS = (1, 2, 3)

# -- rotary3
D_ANG = {1: math.radians(90.0), 2: math.radians(210.0), 3: math.radians(330.0)}
def _knee(q, p, i):
    a = q[f"q{i}"] + p[f"zero{i}"]
    r = p[f"rad{i}"] + p[f"up{i}"] * ca.cos(a)
    return ca.vertcat(r * math.cos(D_ANG[i]), r * math.sin(D_ANG[i]), p[f"hgt{i}"] - p[f"up{i}"] * ca.sin(a))
def _tip(x): return ca.vertcat(x["x"], x["y"], x["z"])
def _delta_par():
    out = []
    for i in LIMBS:
        out += [Parameter(f"rad{i}", 0.160, 2e-4, "m"), Parameter(f"up{i}", 0.240, 1e-4, "m"), Parameter(f"lo{i}", 0.560, 1.5e-4, "m"),
                Parameter(f"zero{i}", 0.0, 1e-3, "rad"), Parameter(f"hgt{i}", 0.0, 2e-4, "m")]
    return tuple(out)
XYZ = tuple(Coordinate(a, "m") for a in "xyz")
rotary3 = Machine(
    name="rotary3", source="drawing of my machine", about="rotary delta with geared cranks: x, y, z", drive="gear",
    pose=XYZ, joints=tuple(Coordinate(f"q{i}", "rad", -1.2, 2.2) for i in LIMBS),
    command=(Coordinate("x", "m", -0.25, 0.25), Coordinate("y", "m", -0.25, 0.25), Coordinate("z", "m", -0.65, -0.35)),
    home={"x": 0.0, "y": 0.0, "z": -0.50}, parameters=_delta_par(), components=tuple(Component(a, "m", True) for a in "xyz"), lever=0.24,
    closure=lambda x, q, p: [ca.norm_2(_tip(x) - _knee(q, p, i)) - p[f"lo{i}"] for i in LIMBS],
    platform=lambda x: (ca.SX.eye(3), _tip(x)), commanded=lambda x, tip: [x["x"], x["y"], x["z"]], target=lambda c: [c["x"], c["y"], c["z"]],
    guess=lambda c: ([c["x"], c["y"], c["z"]], [0.6] * 3),
    struts=lambda x, q, p: [(_knee(q, p, i), _tip(x)) for i in LIMBS],
    skeleton=lambda x, q, p: [[_knee(q, p, i), _tip(x)] for i in LIMBS],
)

# -- slide3
S_ANG = {1: math.radians(210.0), 2: math.radians(330.0), 3: math.radians(90.0)}
INW = {i: S_ANG[i] - math.pi for i in LIMBS}
def _circ(r, a): return ca.vertcat(r * ca.cos(a), r * ca.sin(a))
def _limb(x, q, p, i):
    elbow = _circ(0.420, S_ANG[i]) + ca.vertcat(p[f"mx{i}"], p[f"my{i}"]) + _circ(p[f"crank{i}"], q[f"q{i}"] + p[f"zero{i}"])
    pl = _circ(0.110, S_ANG[i]) + ca.vertcat(p[f"px{i}"], p[f"py{i}"])
    c, s = ca.cos(x["phi"]), ca.sin(x["phi"])
    joint = ca.vertcat(x["x"] + c * pl[0] - s * pl[1], x["y"] + s * pl[0] + c * pl[1])
    return ca.vertcat(elbow, 0.0), ca.vertcat(joint, 0.0)
def _plate(x):
    c, s = ca.cos(x["phi"]), ca.sin(x["phi"])
    return ca.blockcat([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), ca.vertcat(x["x"], x["y"], 0.0)
def _slide_par():
    out = []
    for i in LIMBS:
        out += [Parameter(f"crank{i}", 0.230, 1e-4, "m"), Parameter(f"rod{i}", 0.270, 1e-4, "m"), Parameter(f"zero{i}", 0.0, 2e-3, "rad"),
                Parameter(f"mx{i}", 0.0, 2e-4, "m"), Parameter(f"my{i}", 0.0, 2e-4, "m"), Parameter(f"px{i}", 0.0, 1e-4, "m"), Parameter(f"py{i}", 0.0, 1e-4, "m")]
    return tuple(out)
PL = (("x", "m"), ("y", "m"), ("phi", "rad"))
slide3 = Machine(
    name="slide3", source="drawing of my machine", about="plate on a table, three geared cranks: x, y, phi", drive="gear",
    pose=tuple(Coordinate(n, u) for n, u in PL), joints=tuple(Coordinate(f"q{i}", "rad", INW[i] - 0.3, INW[i] + 2.4) for i in LIMBS),
    command=(Coordinate("x", "m", -0.20, 0.20), Coordinate("y", "m", -0.20, 0.20), Coordinate("phi", "rad", -0.3, 0.3)),
    home={"x": 0.0, "y": 0.0, "phi": 0.0}, parameters=_slide_par(), components=tuple(Component(n, u, True) for n, u in PL), lever=0.42,
    closure=lambda x, q, p: [ca.norm_2(_limb(x, q, p, i)[1] - _limb(x, q, p, i)[0]) - p[f"rod{i}"] for i in LIMBS],
    platform=_plate, commanded=lambda x, tip: [x["x"], x["y"], x["phi"]], target=lambda c: [c["x"], c["y"], c["phi"]],
    guess=lambda c: ([c["x"], c["y"], c["phi"]], [INW[i] + 1.0 for i in LIMBS]),
    read_error=lambda c, twist: [twist[0], twist[1], twist[5]],
    struts=lambda x, q, p: [_limb(x, q, p, i) for i in LIMBS],
    skeleton=lambda x, q, p: [list(_limb(x, q, p, i)) for i in LIMBS],
)

# -- hang3
H_ANG = {1: math.radians(80.0), 2: math.radians(200.0), 3: math.radians(320.0)}
def _eye(p, i):
    return ca.vertcat(1.6 * math.cos(H_ANG[i]) + p[f"ax{i}"], 1.6 * math.sin(H_ANG[i]) + p[f"ay{i}"], 2.4 + p[f"az{i}"])
L0 = math.hypot(1.6, 1.5)
def _hang_par():
    out = []
    for i in LIMBS:
        out += [Parameter(f"ax{i}", 0.0, 1e-3, "m"), Parameter(f"ay{i}", 0.0, 1e-3, "m"), Parameter(f"az{i}", 0.0, 1e-3, "m"),
                Parameter(f"len{i}", 0.0, 1e-3, "m"), Parameter(f"drum{i}", 0.05, 2e-5, "m")]
    return tuple(out)
hang3 = Machine(
    name="hang3", source="drawing of my machine", about="a load that hangs on three cables from drums: x, y, z", drive="cable",
    pose=XYZ, joints=tuple(Coordinate(f"q{i}", "rad", -40.0, 40.0) for i in LIMBS),
    command=(Coordinate("x", "m", -0.7, 0.7), Coordinate("y", "m", -0.7, 0.7), Coordinate("z", "m", 0.4, 1.4)),
    home={"x": 0.0, "y": 0.0, "z": 0.90}, parameters=_hang_par(), components=tuple(Component(a, "m", True) for a in "xyz"), lever=1.0,
    closure=lambda x, q, p: [ca.norm_2(_tip(x) - _eye(p, i)) - L0 - p[f"len{i}"] - p[f"drum{i}"] * q[f"q{i}"] for i in LIMBS],
    platform=lambda x: (ca.SX.eye(3), _tip(x)), commanded=lambda x, tip: [x["x"], x["y"], x["z"]], target=lambda c: [c["x"], c["y"], c["z"]],
    guess=lambda c: ([c["x"], c["y"], c["z"]], [0.0] * 3),
    struts=lambda x, q, p: [(_eye(p, i), _tip(x)) for i in LIMBS],
    skeleton=lambda x, q, p: [[_eye(p, i), _tip(x)] for i in LIMBS],
    cable_stiffness=(float("inf"),) * 3,
)
