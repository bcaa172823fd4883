"""A planar 3-RRR robot: motors, cranks and rods move a plate on a table.

Motor B_i turns crank i; a rod joins the crank's end E_i, the elbow, to the plate at A_i:

    0 = |A_i - E_i| - rod_i,  E_i = B_i + crank_i (cos(q_i + zero_i), sin(q_i + zero_i))
"""

import math

import casadi as ca

from oed import Component, Coordinate, Machine, Parameter, PointGroup

LIMBS = (1, 2, 3)
BASE, PLATE, CRANK, ROD = 0.350, 0.100, 0.200, 0.220  # m, from the drawing
ANGLE = {1: math.radians(210.0), 2: math.radians(330.0), 3: math.radians(90.0)}
INWARD = {i: ANGLE[i] - math.pi for i in LIMBS}  # from a motor to the middle
TURN = math.radians(20.0)
POSE = {"x": "m", "y": "m", "phi": "rad"}


def on_circle(radius, angle):
    return ca.vertcat(radius * ca.cos(angle), radius * ca.sin(angle))


def limb(x, q, p, i):
    """Motor B, elbow E and plate joint A of limb i, each (2,), in the base frame."""
    motor = on_circle(BASE, ANGLE[i]) + ca.vertcat(p[f"db{i}x"], p[f"db{i}y"])
    elbow = motor + on_circle(p[f"crank{i}"], q[f"q{i}"] + p[f"zero{i}"])
    on_plate = on_circle(PLATE, ANGLE[i]) + ca.vertcat(p[f"da{i}x"], p[f"da{i}y"])
    rotation, point = platform(x)
    return motor, elbow, point[:2] + rotation[:2, :2] @ on_plate


def closure(x, q, p):
    limbs = {i: limb(x, q, p, i) for i in LIMBS}
    return [ca.norm_2(limbs[i][2] - limbs[i][1]) - p[f"rod{i}"] for i in LIMBS]


def platform(x):
    """Rotation (3 x 3) and tool point (3,), in the plate's middle; the table is z = 0."""
    c, s = ca.cos(x["phi"]), ca.sin(x["phi"])
    rotation = ca.blockcat([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return rotation, ca.vertcat(x["x"], x["y"], 0.0)


def target(c):
    return [c["r"] * ca.cos(c["az"]), c["r"] * ca.sin(c["az"]), c["phi"]]


def guess(c):
    """The commanded pose with all elbows to the left of the line to the middle."""
    return target(c), [INWARD[i] + 1.0 for i in LIMBS]


def skeleton(x, q, p):
    limbs = [[ca.vertcat(point, 0.0) for point in limb(x, q, p, i)] for i in LIMBS]
    return [*limbs, [limbs[k][2] for k in (0, 1, 2, 0)]]


parameters, joints_of_plate = [], []
for i in LIMBS:
    parameters += [
        Parameter(f"crank{i}", CRANK, 0.1e-3, "m", f"length of crank {i}"),
        Parameter(f"rod{i}", ROD, 0.1e-3, "m", f"length of rod {i}"),
        Parameter(f"zero{i}", 0.0, 5.0e-3, "rad", f"zero of motor {i}"),
        Parameter(f"db{i}x", 0.0, 0.2e-3, "m", f"x error of motor {i}"),
        Parameter(f"db{i}y", 0.0, 0.2e-3, "m", f"y error of motor {i}"),
        Parameter(f"da{i}x", 0.0, 0.1e-3, "m", f"x error of plate joint {i}"),
        Parameter(f"da{i}y", 0.0, 0.1e-3, "m", f"y error of plate joint {i}"),
    ]
    place = (PLATE * math.cos(ANGLE[i]), PLATE * math.sin(ANGLE[i]), 0.0)
    joints_of_plate.append(((f"da{i}x", f"da{i}y", ""), place))  # nothing moves along z

machine = Machine(
    name="my_machine",
    source="drawing of my machine",
    about="planar 3-RRR robot: x, y and a turn by three motors",
    pose=tuple(Coordinate(name, unit) for name, unit in POSE.items()),
    joints=tuple(Coordinate(f"q{i}", "rad", INWARD[i], INWARD[i] + 2.0) for i in LIMBS),
    command=(
        Coordinate("r", "m", 0.0, 0.120),
        Coordinate("az", "rad", -2.0 * math.pi, 2.0 * math.pi),
        Coordinate("phi", "rad", -TURN, TURN),
    ),
    home={"r": 0.0, "az": 0.0, "phi": 0.0},
    parameters=tuple(parameters),
    components=tuple(Component(name, unit, True) for name, unit in POSE.items()),
    lever=BASE,
    closure=closure,
    platform=platform,
    commanded=lambda x, tip: [tip[0], tip[1], x["phi"]],
    target=target,
    guess=guess,
    read_error=lambda c, twist: [twist[0], twist[1], twist[5]],
    skeleton=skeleton,  # for drawings: cranks with rods, and the plate
    frame=("db1x", "db1y", "db2y"),  # these three only choose the base frame
    groups=(PointGroup("plate joints", "the tool point", tuple(joints_of_plate)),),
)
