"""Instruments of which part is read: planes, some channels of a pose, tilted beds."""

import numpy as np
import pytest
from sample import refused, resolved
from shipped_models import a3_head, delta

from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import height_probe, laser_ball_bar

ARM = """\
schema = 1
name = "arm"

[machine]
model = "planar_2dof"

[[setup]]
name = "camera"
instrument = "camera"
channels = ["read_y", "read_z"]

[readings]
files = ["arm.csv"]
"""
ARM_ROWS = """\
setup,run,order,y_mm,z_mm,read_y_mm,read_z_mm
camera,a,1,0,100,0.1,100.2
camera,a,2,500,100,500.1,100.1
camera,a,3,0,600,0.2,600.3
"""


def test_a_camera_in_a_plane_has_two_readings_a_pose(tmp_path):
    (tmp_path / "arm.csv").write_text(ARM_ROWS, encoding="utf-8")
    study = resolved(ARM, tmp_path)
    assert study.dataset is not None
    assert len(study.dataset) == 6
    assert [c.name for c in study.setups["camera"].instrument.channels] == [
        "read_y",
        "read_z",
    ]
    assert study.setups["camera"].sigma == (1e-3, 1e-3)


@pytest.mark.parametrize(
    ("channels", "said"),
    [('["read_q"]', "camera has no channel ['read_q']"), ("[]", "must read one of")],
)
def test_channels_that_do_not_exist_are_refused(channels, said):
    assert said in str(refused(ARM, ('["read_y", "read_z"]', channels)))


def test_a_subset_of_channels_reads_and_scatters_as_the_whole_does(rng):
    whole = laser_ball_bar.instrument
    rows = [0, 2, 4]
    part = whole.take_channels([whole.channels[k].name for k in rows])
    gimbal = {"at_x": 0.0, "at_y": -1.0, "at_z": 1.0}
    setups = [mount(whole, "whole", **gimbal), mount(part, "part", **gimbal)]
    m = Measurement(a3_head.machine, setups)
    command = np.array([[1.1, 0.3, 0.2], [1.2, -2.0, 0.4]])
    both = [m.series(name, command) for name in ("whole", "part")]
    theta = m.nominal + 1e-4 * rng.standard_normal(len(m.names))
    theta[m.nuisance_slice("part")] = theta[m.nuisance_slice("whole")]
    full, taken = (m.readings([s], theta).reshape(2, -1) for s in both)
    assert taken == pytest.approx(full[:, rows], abs=1e-15)
    covariances = [m.of(s).reading_covariances(s) for s in both]
    expected = covariances[0][:, rows][:, :, rows]
    assert covariances[1] == pytest.approx(expected, rel=1e-12)


def test_a_contact_with_a_bed_of_known_slopes_by_hand():
    """The reading of a contact is implied: 0 over a plane that rises along x and y."""
    setup = mount(height_probe.contact, "probe", bed_slope_x=6e-3, bed_slope_y=-2e-3)
    m = Measurement(delta.machine, [setup])
    series = m.series("probe", np.array([[0.05, -0.02, 0.03]]))
    theta = m.nominal
    theta[m.nuisance_slice("probe")] = 1e-4
    expected = 0.03 + 1e-4 - 6e-3 * 0.05 - 2e-3 * 0.02
    assert m.readings([series], theta) == pytest.approx([expected], abs=1e-12)
    assert height_probe.contact.implied == 0.0
