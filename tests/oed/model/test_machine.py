"""Machines and instruments say what is wrong with what they are given."""

import dataclasses

import numpy as np
import pytest
from shipped_models import ball_bar, height_probe, linear_delta

from oed.instrument import mount
from oed.measurement import Measurement
from oed.model import Parameter

machine = linear_delta.machine


def test_a_parameter_table_may_change_values_not_names():
    table = [
        dataclasses.replace(p, nominal=p.nominal + 1e-3, tolerance=2e-3)
        for p in machine.parameters
    ]
    other = machine.with_parameters(table)
    assert other.nominal == pytest.approx(machine.nominal + 1e-3)
    assert [p.tolerance for p in other.parameters] == [2e-3] * len(table)
    assert (machine.nominal != other.nominal).all()
    with pytest.raises(ValueError, match="must keep names and order"):
        machine.with_parameters(table[::-1])
    with pytest.raises(ValueError, match="must keep names and order"):
        machine.with_parameters(table[:-1])


def test_an_unknown_parameter_is_told_with_the_known_ones():
    assert machine.parameters[machine.index("arm2")].name == "arm2"
    with pytest.raises(KeyError, match=r"no parameter 'leg2'; it has .*'arm2'"):
        machine.index("leg2")


@pytest.mark.parametrize(("change", "told"), [
    ({"unit": "mm"}, "unit 'mm' is not SI"), ({"tolerance": -1.0}, "tolerance >= 0"),
    ({"tolerance": np.inf}, "must be finite"), ({"nominal": np.nan}, "must be finite"),
])  # fmt: skip
def test_a_parameter_refuses_nonsense(change, told):
    with pytest.raises(ValueError, match=f"parameter a: .*{told}"):
        Parameter(
            **{"name": "a", "nominal": 0.0, "tolerance": 1.0, "unit": "m"} | change
        )


@pytest.mark.parametrize(("change", "told"), [
    ({"parameters": machine.parameters + machine.parameters[:1]}, r"used twice: \['radius'\]"),
    ({"frame": ("angle4",)}, r"unknown parameters \['angle4'\]"),
    ({"home": {"x": 0.0}}, "home must give every command coordinate"),
])  # fmt: skip
def test_a_machine_refuses_nonsense(change, told):
    with pytest.raises(ValueError, match=told):
        dataclasses.replace(machine, **change)


def test_a_set_up_takes_the_instruments_defaults():
    there = {"at_x": 0.1, "at_y": 0.2, "at_z": 0.3}
    setup = mount(ball_bar.free_cup, "bar", tolerances={"cup_z": 0.005}, **there)
    assert setup.settings == {"length": 0.3, "at_x": 0.1, "at_y": 0.2, "at_z": 0.3}
    assert [n.tolerance for n in setup.nuisances] == [1e-3, 1e-3, 5e-3]
    assert setup.sigma == (0.5e-6,)
    assert mount(height_probe.instrument, "probe", sigma=[7e-6]).sigma == (7e-6,)


@pytest.mark.parametrize(("instrument", "given", "told"), [
    (ball_bar.free_cup, {"at_x": 0.0, "at_y": 0.0}, "needs at_z"),
    (ball_bar.instrument, {"teach": (0, 0, 0), "lenght": 0.3}, r"no setting \['lenght'\]; it has \['length'\]"),
    (ball_bar.instrument, {"teach": (0, 0, 0), "tolerances": {"cup": 1.0}}, r"no unknown \['cup'\]"),
    (ball_bar.instrument, {}, "a teach pose goes with instruments that are taught"),
    (height_probe.instrument, {"teach": (0, 0, 0)}, "a teach pose goes with instruments that are taught"),
    (height_probe.instrument, {"sigma": (1e-6, 1e-6)}, r"one sigma for each of \['height'\]"),
])  # fmt: skip
def test_a_set_up_refuses_nonsense(instrument, given, told):
    with pytest.raises(ValueError, match=f"set-up here: .*{told}"):
        mount(instrument, "here", **given)


def test_two_set_ups_of_one_name_are_refused():
    probe = mount(height_probe.instrument, "probe")
    with pytest.raises(ValueError, match="not unique"):
        Measurement(machine, [probe, probe])
