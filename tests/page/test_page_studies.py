"""Studies from the page's form, and results as cards: what is written, what is refused."""

from typing import Any

import msgspec
import pytest
import report_fixture

from oed.result import AcceptanceSection, PromiseRecord
from page.page_server import Client, served
from pkm_page import server
from pkm_page.new_study import FieldError, NewStudy, StudyForm
from pkm_studies.base import InputError
from pkm_studies.study import Study


def form(**values: Any) -> NewStudy:
    return NewStudy(machine="delta", instrument="pose_tracker_position", **values)


def test_the_file_has_what_the_form_says(tmp_path):
    """Sizes, time and wanted accuracy stand in the study that the command reads."""
    sizes = {"arm_mm": "350.0", "angle_deg": "[210, 330, 90]", "lean_deg": ""}
    page = StudyForm(tmp_path)
    path = page.write(
        form(name="mine", sizes=sizes, time="60", wanted={"z_um": "40", "x_um": ""})
    )
    assert path == tmp_path / "mine.study.toml"
    study = Study.load(path)
    assert study.machine.geometry["arm_mm"] == 350.0
    assert study.prediction.wanted == {"z_um": 40}
    assert study.design.size is not None
    shown = {field.key: field for field in page.sizes("delta")}
    assert [[float(cell) for cell in row] for row in shown["arm_mm"].rows] == [
        [345] * 3
    ]
    assert shown["arm_mm"].label == "arm [mm]"


def test_a_derived_list_has_a_cell_for_each_cable(tmp_path):
    shown = {field.key: field for field in StudyForm(tmp_path).sizes("cable_robot")}
    assert shown["stiffness_N"].rows == [[""] * len(shown["anchor_mm"].rows)]
    assert shown["gear"].rows == [shown["gear"].rows[0][:1] * 4]


def test_one_number_for_all_is_the_same_list(tmp_path):
    """The form shows three arms of 345; left as they are, the study states none."""
    path = StudyForm(tmp_path).write(form(sizes={"arm_mm": "[345, 345, 345]"}))
    assert Study.load(path).machine.geometry == {}


def test_the_forms_file_waits_for_what_must_be_measured(tmp_path):
    path = StudyForm(tmp_path).write(
        NewStudy(machine="a3_head", instrument="laser_ball_bar")
    )
    with pytest.raises(InputError, match=r"at_x_mm .*measure it at your machine"):
        Study.load(path)


@pytest.mark.parametrize(("values", "field"), [
    ({"sizes": {"arm_mm": "long"}}, "geometry.arm_mm"),
    ({"sizes": {"arm_mm": "-1"}}, "geometry.arm_mm"),
    ({"sizes": {"arm_mm": "1\n[setup]"}}, "geometry.arm_mm"),
    ({"sizes": {"arm_mm": '"x"'}}, "geometry.arm_mm"),
    ({"sizes": {"angle_deg": "[1, 2]"}}, "geometry.angle_deg"),
    ({"sizes": {"leg_mm": "1"}}, "geometry.leg_mm"),
    ({"name": "../outside"}, "name"),
    ({"time": "1 min"}, "time"),
    ({"time": "soon"}, "time"),
    ({"wanted": {"z_um": "-3"}}, "wanted.z_um"),
    ({"wanted": {"q_um": "3"}}, "wanted.q_um"),
])  # fmt: skip
def test_an_error_stands_at_its_field(tmp_path, values, field):
    with pytest.raises(FieldError) as error:
        StudyForm(tmp_path).write(form(**values))
    assert error.value.name == field
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_the_user_is_not_overwritten(tmp_path):
    (tmp_path / "mine.study.toml").write_text("of the user", encoding="utf-8")
    with pytest.raises(FieldError) as error:
        StudyForm(tmp_path).write(form(name="mine"))
    assert error.value.name == "name"
    assert (tmp_path / "mine.study.toml").read_text("utf-8") == "of the user"


def test_no_file_of_code_is_a_machine(tmp_path):
    (tmp_path / "mine.py").write_text("raise SystemExit('ran')\n", encoding="utf-8")
    with pytest.raises(FieldError):
        StudyForm(tmp_path).drawing(NewStudy(machine="mine.py"))


def test_results_of_a_folder_are_cards(tmp_path):
    """Two results, one of them in a folder outside that a link names: it stays out."""
    shelf, outside = tmp_path / "shelf", tmp_path / "outside"
    result = msgspec.json.encode(report_fixture.result_of(report_fixture.bare()))
    for folder in (shelf / "a", outside):
        folder.mkdir(parents=True)
        (folder / "result.json").write_bytes(result)
    (shelf / "link").symlink_to(outside)
    with served(shelf, server.PageOptions()) as (opened, port):
        assert opened is None
        client = Client(port)
        text = client.ask("GET", "/results")[1].decode()
        assert text.count("<article") == 1
        key = text.partition('data-result="')[2].partition('"')[0]
        status, report, heads = client.ask("GET", f"/results/{key}/report")
        assert status == 200
        assert b"<h1>" in report
        assert heads["content-security-policy"].startswith("sandbox allow-scripts")
        assert client.post("/compensation", keys=[key], word="../evil.py:run")[0] == 422
        assert client.post("/open", keys=["x"])[0] == 422
        assert [p.name for p in (shelf / "a").iterdir()] == ["result.json"]


def test_an_acceptance_test_is_judged(tmp_path):
    """Against the rms by hand: 3 and 4 um are 3.54 um; what is no such file is not stored."""
    demand = PromiseRecord(
        promised=3.0, limit=3.6, unit="um", uncertainty=0.6, power=0.9
    )
    planned = AcceptanceSection(
        poses=[{"z_mm": 1100.0}, {"z_mm": 1200.0}],
        components={"z": demand},
        reference="absolute",
        miss=1.2,
        false_alarm=0.1,
    )
    result = report_fixture.result_of(report_fixture.bare())
    result = msgspec.structs.replace(result, acceptance=planned)
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "result.json").write_bytes(msgspec.json.encode(result))
    with served(tmp_path, server.PageOptions()) as (_, port):
        client = Client(port)
        text = client.ask("GET", "/results")[1].decode()
        key = text.partition('data-result="')[2].partition('"')[0]
        status, answer = client.post("/judge", key=key, text="x,y\n1,2\n")
        assert status == 422
        assert "z_mm" in answer["error"]
        assert [p.name for p in folder.iterdir()] == ["result.json"]
        filled = "z_mm,error_z_um\n1100,{}\n1200,{}\n"
        for errors, words in (((3, -4), "rms 3.54 um"), ((4, 4), "z: fail: rms 4 um")):
            status, answer = client.post("/judge", key=key, text=filled.format(*errors))
            assert status == 200
            assert words in answer["sentences"][0]
        assert len(list(folder.glob("acceptance-measured-*.csv"))) == 2
        assert "Acceptance test: fail." in client.ask("GET", "/results")[1].decode()
