"""Files that are deeper or larger than any machine: refused at once, with the reason."""

import time

import pytest

from pkm_studies.base import InputError
from pkm_studies.drafts.bodies import xml_file

LOOPS = "loop,link_a,a_x_m,a_y_m,a_z_m,link_b,b_x_m,b_y_m,b_z_m\n1,l1,0,0,0,l2,0,0,0\n"
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
    (tmp_path / "l.csv").write_text(LOOPS)
    files = tmp_path / "r.urdf", tmp_path / "l.csv"
    start = time.perf_counter()
    if words is None:
        assert len(xml_file.read_urdf(*files).bodies) == 4_001
    else:
        with pytest.raises(InputError, match=words):
            xml_file.read_urdf(*files)
    assert time.perf_counter() - start < SOON
