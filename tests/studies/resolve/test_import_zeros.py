"""Joints that count from another zero: strokes of legs in place of their lengths."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies import catalogue, study
from pkm_studies.resolve import replace_nominal, study_machine
from pkm_studies.resolve.machine import ZERO

#: m; base and platform joints of a platform at home 0.6 m up, and the length of its legs
FEET = np.array([[0.5, -0.1, 0.0], [0.5, 0.1, 0.0], [-0.17, 0.49, 0.0]])
FEET = np.vstack([FEET, FEET[[2, 1, 0]] * [1, -1, 1] + [-0.18, 0.0, 0.0]])
TOPS = np.array([[0.19, -0.2, 0.6], [0.19, 0.2, 0.6], [0.09, 0.27, 0.6]])
TOPS = np.vstack([TOPS, TOPS[[2, 1, 0]] * [1, -1, 1] + [-0.18, 0.0, 0.0]])
LEG = """
<body name="leg{k}" pos="{foot}" quat="{turn}"><joint type="ball"/>
  <body name="rod{k}"><joint name="slide{k}" type="slide" axis="0 0 1" ref="{ref}"/>
    <site name="end{k}" pos="0 0 {length}"/></body></body>"""


def drawn(ref: float) -> str:
    """MJCF of the platform; joints read `ref` as drawn."""
    legs = tops = loops = ""
    for k, (foot, top) in enumerate(zip(FEET, TOPS, strict=True)):
        turn, _ = Rotation.align_vectors([top - foot], [[0.0, 0.0, 1.0]])
        words = {
            "foot": " ".join(map(repr, foot.tolist())),
            "turn": " ".join(map(repr, turn.as_quat(scalar_first=True).tolist())),
            "length": repr(float(np.linalg.norm(top - foot))),
        }
        legs += LEG.format(k=k, ref=ref, **words)
        place = " ".join(map(repr, (top - [0.0, 0.0, 0.6]).tolist()))
        tops += f'<site name="top{k}" pos="{place}"/>'
        loops += f'<connect site1="end{k}" site2="top{k}"/>'
    platform = f'<body pos="0 0 0.6"><freejoint/>{tops}</body>'
    world = f"<worldbody>{platform}{legs}</worldbody>"
    return f"<mujoco>{world}<equality>{loops}</equality></mujoco>"


@pytest.mark.usefixtures("own_folder")
@pytest.mark.parametrize("ref", [0.0, 0.125])
def test_a_joint_has_its_zero_where_the_file_has_it(ref, oed, tmp_path):
    (tmp_path / "legs.xml").write_text(drawn(ref))
    code, _, err = oed("new", "mine", "--machine", "legs.xml")
    assert code == 0, err
    machine = study_machine(study.Study.load(tmp_path / "mine.study.toml"))
    kinematics = Kinematics(machine)
    at_home = kinematics.inverse(machine.home_command[None])[1][0]
    assert at_home == pytest.approx(np.full(6, ref), abs=1e-9)
    raised = machine.home_command.copy()
    raised[2] += 0.02
    lengths = np.linalg.norm(TOPS - FEET, axis=1)
    longer = np.linalg.norm(TOPS + np.array([0.0, 0.0, 0.02]) - FEET, axis=1)
    assert kinematics.inverse(raised[None])[1][0] == pytest.approx(
        longer - lengths + ref, abs=1e-9
    )


MACHINES: dict[str, Machine] = {
    name: machine
    for name, (_, machine) in catalogue.named_items("machines").items()
    if any(p.about.startswith(ZERO) for p in machine.parameters)
}


@pytest.mark.parametrize("name", MACHINES)
def test_the_range_of_a_joint_goes_with_its_zero(name):
    model = MACHINES[name]
    zeros = [p.name for p in model.parameters if p.about.startswith(ZERO)]
    strokes = replace_nominal(model, dict.fromkeys(zeros, 0.3))
    command = model.home_command[None]
    before = Kinematics(model).inverse(command)[1][0]
    after = Kinematics(strokes).inverse(command)[1][0]
    for old, new, at, moved in zip(
        model.joints, strokes.joints, before, after, strict=True
    ):
        assert new.lower - old.lower == pytest.approx(moved - at, abs=1e-9)
        assert new.upper - old.upper == pytest.approx(moved - at, abs=1e-9)
