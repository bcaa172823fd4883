"""Loops as public MJCF draws them: two chains that meet, a platform on a leg, welds."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oed.mechanism import Kinematics
from pkm_studies.base import InputError
from pkm_studies.drafts import StartingModel
from pkm_studies.user_code import Consent, Origin

FIVE_BAR = """\
<mujoco model="two_chains">
<compiler angle="radian"/>
<worldbody>
<body name="l1" pos="-0.1 0 0"><joint name="j1" type="hinge" axis="0 0 1"/>
 <body name="l2" pos="-0.06 0.19 0"><joint name="e1" type="hinge" axis="0 0 1"/></body></body>
<body name="r1" pos="0.1 0 0"><joint name="j2" type="hinge" axis="0 0 1"/>
 <body name="r2" pos="0.07 0.18 0"><joint name="e2" type="hinge" axis="0 0 1"/></body></body>
</worldbody>
<equality><connect body1="l2" body2="r2" anchor="0.17 0.2 0"/></equality>
</mujoco>
"""
#: m, joints of a hexapod's legs on the base and, from its platform's frame, on the platform
HOME = np.array([0.0, 0.0, 0.6])
ANGLES = np.radians([10.0, 110.0, 130.0, 230.0, 250.0, 350.0])
BASE = 0.5 * np.c_[np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES]
TURNED = np.radians([50.0, 70.0, 170.0, 190.0, 290.0, 310.0])
PLATFORM = np.c_[0.3 * np.cos(TURNED), 0.3 * np.sin(TURNED), 0 * TURNED]


def text(numbers: np.ndarray) -> str:
    return " ".join(f"{v:.12f}" for v in numbers)


def leg(k: int, end: str) -> str:
    """A leg on a universal joint; `end` is what hangs on its piston."""
    along = HOME + PLATFORM[k] - BASE[k]
    rotation, _ = Rotation.align_vectors([along / np.linalg.norm(along)], [[0, 0, 1]])
    quaternion = text(rotation.as_quat(scalar_first=True))
    end = end.format(k=k, length=np.linalg.norm(along))
    return f"""
<body name="lower{k}" pos="{text(BASE[k])}" quat="{quaternion}">
 <joint name="u{k}" axis="1 0 0"/><joint name="v{k}" axis="0 1 0"/>
 <body name="piston{k}"><joint name="s{k}" type="slide" axis="0 0 1"/>{end}</body>
</body>"""


def stewart(form: str) -> str:
    """Six legs with the platform free and welded to feet, or on a ball of the first leg."""
    foot = '<body name="foot{k}" pos="0 0 {length:.12f}"><joint type="ball"/></body>'
    if form == "weld":
        legs = [leg(k, foot) for k in range(6)]
        legs.append(f'<body name="platform" pos="{text(HOME)}"><freejoint/></body>')
        loops = [f'<weld body1="foot{k}" body2="platform"/>' for k in range(6)]
    else:
        along = HOME + PLATFORM[0] - BASE[0]
        rotation, _ = Rotation.align_vectors(
            [along / np.linalg.norm(along)], [[0, 0, 1]]
        )
        place = rotation.inv().apply(HOME - BASE[0])
        back = text(rotation.inv().as_quat(scalar_first=True))
        ball = text(PLATFORM[0])
        hung = (
            f'<body name="platform" pos="{text(place)}" quat="{back}">'
            f'<joint name="hold" type="ball" pos="{ball}"/></body>'
        )
        legs = [leg(0, hung), *(leg(k, "") for k in range(1, 6))]
        lengths = np.linalg.norm(HOME + PLATFORM - BASE, axis=1)
        loops = [
            f'<connect body1="piston{k}" body2="platform" anchor="0 0 {lengths[k]:.12f}"/>'
            for k in range(1, 6)
        ]
    worldbody, equality = "\n".join(legs), "\n".join(loops)
    return (
        f"<mujoco><worldbody>{worldbody}</worldbody>"
        f"<equality>{equality}</equality></mujoco>"
    )


def read(folder: Path, content: str):
    (folder / "robot.xml").write_text(content)
    return StartingModel.named("robot.xml", Origin(folder, Consent.RECORDED)).machine


def test_two_chains_that_meet_are_a_five_bar(tmp_path):
    """The tool point where circles about both knees meet, at any joints."""
    machine = read(tmp_path, FIVE_BAR)
    assert machine.name == "five_bar"
    kinematics = Kinematics(machine)
    rng = np.random.default_rng(3)
    start, zero = kinematics.inverse(machine.home_command[None])
    assert np.abs(zero).max() < 1e-9  # joints read as drawn
    q = 0.05 * rng.uniform(-1.0, 1.0, (6, 2))
    pose = kinematics.forward(q, machine.nominal, np.repeat(start, 6, axis=0))
    drawn = np.array([[-0.06, 0.19], [0.07, 0.18]])
    tip = np.array([-0.1, 0.0]) + drawn[0] + [0.17, 0.2]
    centre = np.array([[-0.1, 0.0], [0.1, 0.0]])
    strut = np.linalg.norm(tip - centre - drawn, axis=1)
    for angles, x in zip(q, pose, strict=True):
        cos, sin = np.cos(angles), np.sin(angles)
        knees = (
            centre
            + np.c_[
                cos * drawn[:, 0] - sin * drawn[:, 1],
                sin * drawn[:, 0] + cos * drawn[:, 1],
            ]
        )
        between = knees[1] - knees[0]
        d = np.linalg.norm(between)
        a = (strut[0] ** 2 - strut[1] ** 2 + d**2) / (2.0 * d)
        across = np.array([-between[1], between[0]]) / d
        expected = knees[0] + a * between / d + np.sqrt(strut[0] ** 2 - a**2) * across
        np.testing.assert_allclose(x, expected, atol=1e-9)


OPEN = FIVE_BAR.replace(
    '<joint name="e1" type="hinge" axis="0 0 1"/>',
    '<joint name="e1" type="hinge" axis="0 0 1"/><site name="a" pos="0.15 0.2 0"/>',
).replace(
    '<joint name="e2" type="hinge" axis="0 0 1"/>',
    '<joint name="e2" type="hinge" axis="0 0 1"/><site name="b" pos="-0.16 0.21 0"/>',
)
SITES = '<connect site1="a" site2="b"/>'


def test_a_loop_that_is_drawn_open_keeps_its_lengths(tmp_path):
    """Its ends are 2 cm apart as drawn; each strut reaches to its own site."""
    closing = '<connect body1="l2" body2="r2" anchor="0.17 0.2 0"/>'
    machine = read(tmp_path, OPEN.replace(closing, SITES))
    nominal = {p.name: p.nominal for p in machine.parameters}
    struts = [nominal["l1"], nominal["l2"]]
    assert struts == pytest.approx([np.hypot(0.15, 0.2), np.hypot(0.16, 0.21)])


def test_a_knee_that_is_drawn_straight_has_no_side(tmp_path):
    straight = OPEN.replace('pos="0.15 0.2 0"', 'pos="-0.09 0.285 0"')
    straight = straight.replace('pos="-0.16 0.21 0"', 'pos="0.105 0.27 0"')
    closing = '<connect body1="l2" body2="r2" anchor="0.17 0.2 0"/>'
    with pytest.raises(InputError, match=r"crank of j1 and its strut .* in one line"):
        read(tmp_path, straight.replace(closing, SITES))


#: m, a delta: shoulders, cranks, rods, and how far the rods of a pair are from the middle
SHOULDER, CRANK, ROD, FOOT, HALF = 0.1, 0.15, 0.35, 0.05, 0.03
TURNS = np.radians([0.0, 120.0, 240.0])
OUTWARD = np.c_[np.cos(TURNS), np.sin(TURNS), 0 * TURNS]
TANGENT = np.c_[-np.sin(TURNS), np.cos(TURNS), 0 * TURNS]


def delta(half_foot: float = HALF) -> str:
    """Three cranks, each with two rods to a free platform, as CAD programs export a delta."""
    across = SHOULDER + CRANK - FOOT
    height = np.sqrt(ROD**2 - across**2)
    bodies = [f'<body name="platform" pos="0 0 {-height:.12f}"><freejoint/></body>']
    loops = []
    for k, (u, t) in enumerate(zip(OUTWARD, TANGENT, strict=True)):
        rods = ""
        for side in (-1, 1):
            name = f"rod{k}{side}"
            at = text(CRANK * u + side * HALF * t)
            rods += f'<body name="{name}" pos="{at}"><joint type="ball"/></body>'
            end = -across * u + side * (half_foot - HALF) * t - [0.0, 0.0, height]
            loops.append(
                f'<connect body1="{name}" body2="platform" anchor="{text(end)}"/>'
            )
        hinge = f'<joint name="q{k}" axis="{text(t)}"/>'
        arm = f'<body name="arm{k}" pos="{text(SHOULDER * u)}">{hinge}{rods}</body>'
        bodies.append(arm)
    worldbody, equality = "\n".join(bodies), "\n".join(loops)
    return (
        f"<mujoco><worldbody>{worldbody}</worldbody>"
        f"<equality>{equality}</equality></mujoco>"
    )


def test_two_parallel_rods_on_a_crank_are_one_limb_of_a_delta(tmp_path):
    """No hexapod of six cranks; the tool point where three spheres about the knees meet."""
    machine = read(tmp_path, delta())
    assert machine.name == "rotary_delta"
    kinematics = Kinematics(machine)
    q = np.array([[0.0, 0.0, 0.0], [0.05, -0.1, 0.02], [-0.08, 0.03, 0.1]])
    start = np.repeat(machine.home_command[None], 3, axis=0)
    pose = kinematics.forward(q, machine.nominal, start)
    for angles, point in zip(q, pose, strict=True):
        cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
        arms = CRANK * (cos * OUTWARD - sin * [0.0, 0.0, 1.0])
        knees = (SHOULDER - FOOT) * OUTWARD + arms
        reach = np.linalg.norm(point[:3] - knees, axis=1)
        np.testing.assert_allclose(reach, ROD, atol=1e-9)
    with pytest.raises(InputError, match="2 limbs on q0 are no two parallel rods"):
        read(tmp_path, delta(half_foot=0.02))


@pytest.mark.parametrize("form", ["weld", "hung"])
def test_a_stewart_platform_on_a_leg_or_welded(form, tmp_path):
    machine = read(tmp_path, stewart(form))
    assert machine.name == "hexapod_ups"
    numbers = {p.name: p.nominal for p in machine.parameters}
    for k in range(6):
        for axis in range(3):
            letter = "xyz"[axis]
            assert numbers[f"b{k + 1}{letter}"] == pytest.approx(
                BASE[k, axis], abs=1e-9
            )
            assert numbers[f"a{k + 1}{letter}"] == pytest.approx(
                PLATFORM[k, axis], abs=1e-9
            )
    kinematics = Kinematics(machine)
    _, q = kinematics.inverse(machine.home_command[None])
    assert np.abs(q).max() < 1e-9


@pytest.mark.parametrize(("old", "new", "reason"), [
    ("<connect", "<weld", "<weld> joins 'l2' and 'r2', neither of which hangs"),
    ("<connect", "<joint", "<joint> that is no active connection"),
    ('<joint name="e2" type="hinge" axis="0 0 1"/>', '<joint name="e2" type="slide" axis="0 0 1"/>',
     "do not share one body, the platform"),
    ('axis="0 0 1"/></body></body>\n<body name="r1"',
     'axis="0 1 0"/></body></body>\n<body name="r1"', "do not share one body"),
])  # fmt: skip
def test_what_closes_no_machine(old, new, reason, tmp_path):
    assert old in FIVE_BAR
    with pytest.raises(InputError, match=reason):
        read(tmp_path, FIVE_BAR.replace(old, new))
