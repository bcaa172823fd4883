"""`oed new --machine FILE` for MJCF and URDF: where MuJoCo puts it, loops, sizes."""

import time
from pathlib import Path
from typing import Any

import compensation_sample as sample
import numpy as np
import pytest
from oracles import mujoco_poses
from scipy.spatial.transform import Rotation
from shipped_models import five_bar, hexapod, orthoglide, rotary_delta

from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies import study
from pkm_studies.base import InputError
from pkm_studies.drafts import StartingModel
from pkm_studies.drafts.bodies import xml_file
from pkm_studies.resolve import study_machine
from pkm_studies.user_code import Consent, Origin

#: a rotary delta by hand: degrees, nested and turned bodies, universal joints of two
#: hinges, sites, defaults, names of its own, shoulders and ankles away from the axis
HAND = """\
<mujoco>
  <compiler eulerseq="XYZ"/>
  <option gravity="0 0 -9.81"/>
  <default>
    <default class="knee"><joint type="ball"/></default>
    <default class="motor"><joint axis="0 1 0" range="-60 95"/></default>
  </default>
  <worldbody>
    <body name="frame" pos="0 0 1" euler="0 0 0">
      @ARMS@
    </body>
    <body name="head" pos="0 0 0.30">
      <joint type="slide" axis="1 0 0" ref="0"/>
      <joint type="slide" axis="0 1 0"/>
      <joint type="slide" axis="0 0 1" ref="0.30"/>
      <geom size="0.02"/>
      <site name="tcp" pos="0 0 -0.05"/>
      <site name="ankle0" pos="0.04 0 0"/>
      <site name="ankle1" pos="-0.02 0.034641016151377546 0"/>
      <site name="ankle2" pos="-0.02 -0.034641016151377546 0"/>
    </body>
  </worldbody>
  <equality>
    <connect site1="end0" site2="ankle0"/>
    <connect site1="end1" site2="ankle1"/>
    <connect site1="end2" site2="ankle2"/>
  </equality>
  <actuator><position joint="arm0" kp="10"/></actuator>
</mujoco>
"""
ARM = """\
<body name="hip{k}" euler="0 0 {turn}" pos="{x} {y} 0">
  <body name="thigh{k}" quat="1 0 0 0">
    <joint name="arm{k}" class="motor" ref="10"/>
    <geom size="0.01"/>
    <body name="shin{k}" pos="{out} 0 {down}">
      <joint class="knee"/>
      <geom type="capsule" fromto="0 0 0 {dx} 0 {dz}" size="0.005"/>
      <site name="end{k}" pos="{dx} 0 {dz}"/>
    </body>
  </body>
</body>
"""


def hand_written() -> str:
    """The delta at home: hips at 0.12 m, arms of 0.2 m at 10 degrees, shins to the head."""
    out, down = 0.2 * np.cos(np.radians(10.0)), -0.2 * np.sin(np.radians(10.0))
    dx, dz = 0.04 - (0.12 + out), 0.30 - (1.0 + down)
    arms = [
        ARM.format(
            k=k,
            turn=120.0 * k,
            x=0.12 * np.cos(2 * np.pi * k / 3),
            y=0.12 * np.sin(2 * np.pi * k / 3),
            out=out,
            down=down,
            dx=dx,
            dz=dz,
        )
        for k in range(3)
    ]
    return HAND.replace("@ARMS@", "".join(arms))


@pytest.fixture(scope="module")
def mujoco() -> Any:
    return pytest.importorskip("mujoco", reason="MuJoCo is not installed")


def differences(
    mujoco: Any, model: Any, machine: Machine, names: list[str], tool: np.ndarray
) -> float:
    """Largest distance of MuJoCo's tool point from the machine's, at joints near home."""
    kinematics = Kinematics(machine)
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    rng, loops = np.random.default_rng(5), mujoco_poses.connections(mujoco, model)
    shape = (5, len(low))
    command = machine.home_command + 0.3 * (high - low) * rng.uniform(-1, 1, shape)
    x, q = kinematics.inverse(np.vstack([machine.home_command, command]))
    largest, platform = 0.0, loops[0][2]
    for pose, joints in zip(x[1:], q[1:], strict=True):
        data = mujoco.MjData(model)
        for share in np.linspace(0.25, 1.0, 4):
            at = q[0] + share * (joints - q[0])
            named = dict(zip(names, at, strict=True))
            gap = mujoco_poses.close(mujoco, model, data, named, loops)
        assert gap < 1e-12
        turned = data.xmat[platform].reshape(3, 3)
        point = data.xpos[platform] + turned @ tool
        expected = kinematics.frames(pose[None], np.zeros(3))
        largest = max(largest, np.abs(point - expected[1][0]).max())
        largest = max(largest, np.abs(turned - expected[0][0]).max())
    return largest


@pytest.mark.usefixtures("own_folder")
def test_a_hand_written_delta_stands_where_mujoco_puts_it(oed, tmp_path, mujoco):
    (tmp_path / "delta.xml").write_text(hand_written(), "utf-8")
    code, out, err = oed("new", "mine", "--machine", "delta.xml")
    assert code == 0, err
    assert "q1 is arm0, q2 is arm1, q3 is arm2" in out
    assert "actuator" in out
    file = tmp_path / "mine.study.toml"
    assert oed("check", file)[0] == 0
    machine = study_machine(study.Study.load(file))
    assert machine.nominal[machine.index("r1")] == pytest.approx(0.2, abs=1e-12)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "delta.xml"))
    tool = np.array([0.0, 0.0, -0.05])
    names = ["arm0", "arm1", "arm2"]
    assert differences(mujoco, model, machine, names, tool) < 1e-9


@pytest.mark.usefixtures("own_folder")
@pytest.mark.parametrize(("original", "form"), [
    pytest.param(hexapod.machine, "urdf", id="legs"),
    pytest.param(rotary_delta.machine, "urdf", id="rotary_delta"),
    pytest.param(orthoglide.machine, "urdf", id="orthoglide"),
    pytest.param(five_bar.machine, "mjcf", id="five_bar"),
])  # fmt: skip
def test_what_was_written_comes_back_as_the_same_machine(
    original, form, oed, tmp_path, rng
):
    tolerance = np.array([p.tolerance for p in original.parameters])
    values = original.nominal + 0.3 * tolerance * rng.standard_normal(len(tolerance))
    folder = sample.save(tmp_path / "d", sample.result(original, values))
    assert oed("compensate", folder, "--to", form)[0] == 0
    file, loops = folder / "compensation.mjcf.xml", []
    if form == "urdf":
        file = folder / "compensation.urdf"
        loops = ["--loops", folder / "compensation_loops.csv"]
    code, _, err = oed("new", "back", "--machine", file, *loops)
    assert code == 0, err
    machine = study_machine(study.Study.load(tmp_path / "back.study.toml"))
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    command = rng.uniform(low, high, (10, len(low)))
    _, expected = Kinematics(original).inverse(command, values)
    assert Kinematics(machine).inverse(command)[1] == pytest.approx(expected, abs=1e-9)


@pytest.mark.usefixtures("own_folder")
@pytest.mark.parametrize(("old", "new", "words"), [
    ("<equality>", "<equality><weld body1='head' body2='frame'/>", "<weld>"),
    ('<site name="tcp"', '<composite/><site name="tcp"', "<composite> is not read"),
    ('site1="end0"', 'site1="nowhere"', "names site 'nowhere'"),
    ('<joint type="slide" axis="0 1 0"/>', '<joint type="hinge"/>', "body head has"),
    ('<joint type="ball"/>', '<joint type="slide"/>', "does not move along"),
    ("</mujoco>", "", "this is no XML file"),
    ('pos="0 0 1"', 'pos="0 0 nan"', "'0 0 nan' is no place"),
    ('pos="0 0 1"', 'pos="0 0 1e300"', "is no place"),
    ('pos="0 0 1"', 'pos="0 0"', "'0 0' are not 3 numbers"),
    ('axis="0 1 0" range', 'axis="0 0 0" range', "has no direction"),
    ('quat="1 0 0 0"', 'quat="0 0 0 0"', "has no direction"),
    ('quat="1 0 0 0"', 'axisangle="0 0 0 1"', "has no direction"),
    ('quat="1 0 0 0"', 'xyaxes="1 0 0 2 0 0"', "are no two axes"),
    ('ref="10"', 'ref="ten"', "'ten' are no numbers"),
    ('eulerseq="XYZ"', 'eulerseq="XYW"', "no order of axes"),
    ('name="hip1"', 'name="hip0"', "have the name 'hip0'"),
])  # fmt: skip
def test_what_is_no_machine_of_a_family_is_refused(old, new, words, oed, tmp_path):
    text = hand_written()
    assert old in text
    (tmp_path / "bad.xml").write_text(text.replace(old, new), "utf-8")
    code, _, err = oed("new", "mine", "--machine", "bad.xml")
    assert code == 2
    assert words in err
    assert not (tmp_path / "mine.study.toml").exists()


@pytest.mark.usefixtures("own_folder")
def test_a_urdf_needs_its_loops(oed, tmp_path):
    (tmp_path / "robot.urdf").write_text("<robot name='r'><link name='a'/></robot>")
    code, _, err = oed("new", "mine", "--machine", "robot.urdf")
    assert code == 2
    assert "URDF has no loops" in err


LOOPS = "loop,link_a,a_x_m,a_y_m,a_z_m,link_b,b_x_m,b_y_m,b_z_m\n"


@pytest.mark.usefixtures("own_folder")
@pytest.mark.parametrize(("urdf", "loops", "words"), [
    ("", None, "there is no such table of loops"),
    ("", "1,a,0,0,0,b,0,,0\n", "are no numbers"),
    ("", "1,a,0,0,0,b,0,nan,0\n", "no place"),
    ('<origin xyz="0 0"/>', "", "are not 3 numbers"),
    ('<axis xyz="0 0 0"/>', "", "has no direction"),
    ('</joint><joint><parent link="a"/>', "", "no child"),
    ('</joint><joint type="fixed"><parent link="a"/><child link="b"/>', "", "two"),
    ('</joint><joint type="fixed"><parent link="b"/><child link="a"/>', "", "own"),
    ('</joint><joint type="fixed"><parent link="c"/><child link="a"/>', "", "c"),
])  # fmt: skip
def test_a_broken_urdf_is_refused(urdf, loops, words, oed, tmp_path):
    links = '<link name="a"/><link name="b"/>'
    joint = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
    (tmp_path / "r.urdf").write_text(f"<robot>{links}{joint}{urdf}</joint></robot>")
    if loops is not None:
        (tmp_path / "l.csv").write_text(LOOPS + loops)
    code, _, err = oed("new", "mine", "--machine", "r.urdf", "--loops", "l.csv")
    assert (code, words in err) == (2, True), err


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


ONE_LOOP = (
    "loop,link_a,a_x_m,a_y_m,a_z_m,link_b,b_x_m,b_y_m,b_z_m\n1,l1,0,0,0,l2,0,0,0\n"
)
#: s; each of these took minutes, or did not end, where time grew with the square
SOON = 5.0


def chain(count: int, *, is_long: bool = True) -> str:
    """URDF of links behind one another, or all on the base."""
    links = "".join(f"<link name='l{k}'/>" for k in range(count + 1))
    joints = "".join(
        f"<joint name='j{k}' type='revolute'><parent link='l{k if is_long else 0}'/>"
        f"<child link='l{k + 1}'/></joint>"
        for k in range(count)
    )
    return f"<robot name='r'>{links}{joints}</robot>"


@pytest.mark.parametrize("count", [201, 30_000])
def test_nested_bodies_beyond_any_machine_are_refused(count, oed, tmp_path):
    bodies = "<body><joint/>" * count + "</body>" * count
    text = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    (tmp_path / "deep.xml").write_text(text)
    code, _, err = oed("new", "mine", "--machine", tmp_path / "deep.xml")
    assert (code, "more than 200 within one another" in err) == (2, True), err


def test_bodies_within_the_bound_are_read(tmp_path):
    # 95 bodies, 1 m each along the turned x: 95 turns of 90 deg about z stand at x = 0
    body = "<body pos='1 0 0' euler='0 0 90'><joint/>"
    loop = "<connect body1='body95' body2='world' anchor='0 0 0'/>"
    text = f"<worldbody>{body * 95}{'</body>' * 95}</worldbody>"
    (tmp_path / "m.xml").write_text(
        f"<mujoco>{text}<equality>{loop * 2}</equality></mujoco>"
    )
    tree = xml_file.read_mjcf(tmp_path / "m.xml")
    assert len(tree.joints("body95")) == 95
    # steps east, north, west, south sum to 0 over each four; three are left
    assert tree.frame("body95")[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(("text", "words"), [
    (chain(20_000), "more than 20000 elements"),
    (chain(4_000), "hangs on more than 200 others"),
    (chain(4_000, is_long=False), None),
])  # fmt: skip
def test_time_grows_with_the_number_of_links(text, words, tmp_path):
    (tmp_path / "r.urdf").write_text(text)
    (tmp_path / "l.csv").write_text(ONE_LOOP)
    files = tmp_path / "r.urdf", tmp_path / "l.csv"
    start = time.perf_counter()
    if words is None:
        assert len(xml_file.read_urdf(*files).bodies) == 4_001
    else:
        with pytest.raises(InputError, match=words):
            xml_file.read_urdf(*files)
    assert time.perf_counter() - start < SOON
