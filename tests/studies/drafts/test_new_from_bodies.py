"""`oed new --machine FILE` for MJCF and URDF: the study's machine stands where MuJoCo puts
the platform of the file, and files that describe no family are refused.
"""

from typing import Any

import compensation_sample as sample
import numpy as np
import pytest
from oracles import mujoco_poses
from shipped_models import five_bar, hexapod, orthoglide, rotary_delta

from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies import study
from pkm_studies.resolve import study_machine

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
