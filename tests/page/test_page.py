"""The page at the machine: decisions of the command, two pages at once, approaches."""

import csv
import re
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import sample

from page import page_server
from page.page_server import rows, take
from pkm_page import readings_log, server, typed
from pkm_page.machine_page import BackgroundCommand
from pkm_page.readings_log import ReadingsLog, StaleError
from pkm_studies.sessions import Adviser
from pkm_studies.study import Study


# -- measuring -------------------------------------------------------------------------
def test_page_and_command_decide_alike(machine, page_study):
    """After each reading, `oed next` on the page's file says the same pose and figures."""
    opened, client, operator = machine
    adviser = Adviser(Study.load(page_study))
    path = opened.session.log.path
    for number in range(1, 5):
        status, state = take(client, operator.display())
        assert status == 200
        assert len(rows(path)) == number
        advice = adviser.advise(path)
        shown = opened.session.state.advice
        assert shown.candidate == advice.candidate
        assert shown.known == pytest.approx(advice.known, rel=1e-12)
        assert f"Reading {number + 1} of" in state["parts"]["pose"]
    said = " ".join(adviser.advice_sentences(advice))
    command = dict(
        re.findall(r"(\w+_(?:mm|deg)) = ([-\d.]+)", said.partition("joints")[0])
    )
    shown_numbers = re.findall(
        r"<b>([^<]+)</b> <span>(?:mm|deg)", state["parts"]["pose"]
    )
    assert [float(n.replace("\u2212", "-")) for n in shown_numbers] == pytest.approx(
        [float(v) for v in command.values()], abs=1e-4
    )


def test_what_is_shown_is_what_is_written(machine):
    """Commands have the decimals that the operator sees, and the clock runs."""
    opened, client, operator = machine
    take(client, operator.display())
    take(client, operator.display(), remark="bar seated anew")
    first, second = rows(opened.session.log.path)
    assert re.fullmatch(r"-?\d+(\.\d{1,4})?", first["theta_deg"])
    assert float(first["time_s"]) <= float(second["time_s"])
    assert second["remark"] == "bar seated anew"


def test_an_implausible_reading_is_asked_about_first(machine):
    opened, client, operator = machine
    for _ in range(3):
        take(client, operator.display())
    right = operator.display()[0]
    wrong = right.replace(".", "")[:2] + "." + right.replace(".", "")[2:]
    status, answer = take(client, [wrong])
    assert status == 409
    assert "decimal point misplaced" in answer["doubts"][0]
    assert len(rows(opened.session.log.path)) == 3
    status, _ = take(client, [wrong], confirmed=True)
    assert status == 200
    assert len(rows(opened.session.log.path)) == 4


def test_no_number_is_no_reading(machine):
    opened, client, _ = machine
    for text in ("", "abc", "1.2.3", "1,234.5", "nan", "inf", "1e3", "3" * 30, "0x10"):
        status, answer = take(client, [text], confirmed=True)
        assert status == 422
        assert "length_mm" in answer["error"]
    assert not opened.session.log.path.exists()


def test_undo_keeps_the_value_in_the_remark(machine):
    opened, client, operator = machine
    entries = operator.display()
    take(client, entries)
    before = client.state()["parts"]["pose"]
    status, state = client.post("/undo", version=client.state()["version"])
    assert status == 200
    (row,) = rows(opened.session.log.path)
    assert row["length_mm"] == ""
    assert row["remark"] == f"undone: length_mm = {entries[0].rstrip('0')}"
    assert "Reading 1 of" in state["parts"]["pose"] != before


def test_a_pose_is_read_again(machine):
    opened, client, operator = machine
    take(client, operator.display())
    client.post("/repeat", version=client.state()["version"], again=True)
    take(client, operator.display())
    first, second = rows(opened.session.log.path)
    for name in ("setup", "z_mm", "psi_deg", "theta_deg"):
        assert first[name] == second[name]


def test_rows_of_a_plan_and_of_a_user_stay(machine):
    """Semicolons, decimal commas, other units and remarks are those of the file."""
    opened, client, operator = machine
    take(client, operator.display())
    (row,) = rows(opened.session.log.path)
    cells = [
        row["setup"], row["run"], "7", row["z_mm"], row["psi_deg"], row["theta_deg"],
    ]  # fmt: skip
    text = "# mine\nsetup;run;order;z_mm;psi_deg;theta_deg;length_um;note\n"
    text += ";".join(cells).replace(".", ",") + ";;planned; by hand\n".replace(
        "; by", " by"
    )
    opened.session.log.path.write_text(text, encoding="utf-8")
    opened.session.refresh()
    status, _ = take(client, operator.display(), confirmed=True)
    assert status == 200
    after = opened.session.log.path.read_text("utf-8")
    assert after.startswith("# mine\n")
    (last,) = csv.reader(after.splitlines()[-1:], delimiter=";")
    assert last[2] == "8"
    assert 2.9e5 < float(last[6].replace(",", ".")) < 3.1e5
    assert "planned by hand" in after


def test_a_broken_file_is_told_and_taken_up_again(machine):
    opened, client, operator = machine
    take(client, operator.display())
    path = opened.session.log.path
    whole = path.read_text("utf-8")
    path.write_text(whole.replace("z_mm", "z_furlong"), encoding="utf-8")
    opened.session.refresh()
    assert "z_furlong" in client.state()["parts"]["pose"]
    path.write_text(whole, encoding="utf-8")
    opened.session.refresh()
    assert "Reading 2 of" in client.state()["parts"]["pose"]


# -- two at once -----------------------------------------------------------------------
def test_two_pages_never_write_one_reading_twice(machine):
    """Both send for the same state at once: one is taken, the other is told."""
    opened, client, operator = machine
    for number in range(3):
        version, entries = client.state()["version"], operator.display()
        answers: list[int] = []

        def send(
            key: str,
            version: str = version,
            entries: Any = entries,
            answers: Any = answers,
        ) -> None:
            status, _ = client.post(
                "/reading", version=version, key=key, entries=entries, confirmed=True
            )
            answers.append(status)

        threads = [
            threading.Thread(target=send, args=(f"{number} {k}",)) for k in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(answers) == [200, 409, 409, 409]
        assert len(rows(opened.session.log.path)) == number + 1


def test_an_entry_that_is_sent_again_is_taken_once(machine):
    opened, client, operator = machine
    entry = {
        "version": client.state()["version"],
        "key": "one",
        "entries": operator.display(),
    }
    assert [client.post("/reading", **entry)[0] for _ in range(3)] == [200, 200, 200]
    assert len(rows(opened.session.log.path)) == 1


def test_a_change_by_an_editor_is_not_overwritten(tmp_path):
    log = ReadingsLog(tmp_path / "poses.csv")
    first = log.write(readings_log.ABSENT, log.read().replace_rows([{"setup": "a"}]))
    log.path.write_text("setup\nof the user\n", encoding="utf-8")
    with pytest.raises(StaleError):
        log.write(first.version, first.replace_rows([{"setup": "b"}]))
    assert log.path.read_text("utf-8") == "setup\nof the user\n"


def test_pages_hear_of_each_reading(machine):
    """An event arrives for a reading that another page takes, within a second."""
    _, client, operator = machine
    line = socket.create_connection(("127.0.0.1", client.port), timeout=5)
    host = f"127.0.0.1:{client.port}"
    line.sendall(f"GET /events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    heard = b""
    while heard.count(b"data: changed") < 1:
        heard += line.recv(4096)
    take(client, operator.display())
    began = time.monotonic()
    while heard.count(b"data: changed") < 2:
        heard += line.recv(4096)
    assert time.monotonic() - began < 1.0
    line.close()


# -- slips of the hand -----------------------------------------------------------------
@pytest.mark.parametrize(("text", "words"), [
    ("-300.12", "300.12 would fit: is the sign reversed?"),
    ("30.012", "300.12 would fit: is the decimal point misplaced?"),
    ("300.21", "300.12 would fit: were two digits exchanged?"),
    ("3000.12", "300.12 would fit: was a digit typed twice?"),
    ("300.122", "300.12 would fit: was a digit typed twice?"),
    ("3050.12", None),
    ("123.45", None),
])  # fmt: skip
def test_a_slip_is_named(text, words):
    assert typed.slip(text, 300.11, 300.13) == words


# -- poses that cannot be driven to ----------------------------------------------------
def test_a_skipped_pose_is_advised_no_more(machine, page_study):
    """Neither by the page nor by the command, before and after readings; it can be undone."""
    opened, client, operator = machine
    adviser, path = Adviser(Study.load(page_study)), opened.session.log.path
    first = opened.session.state.advice.candidate
    status, state = client.post(
        "/skip", version=client.state()["version"], text="leg 2 collides"
    )
    assert status == 200
    assert "1 pose is skipped" in state["parts"]["pose"]
    (row,) = rows(path)
    assert (row["remark"], row["length_mm"]) == ("skipped: leg 2 collides", "")
    for _ in range(3):
        shown, advice = opened.session.state.advice, adviser.advise(path)
        assert shown.candidate == advice.candidate != first
        assert first in advice.skipped
        take(client, operator.display())
    said = adviser.advice_sentences(advice)
    assert "1 reading is not advised: the file's remarks skip the pose." in said
    status, _ = client.post("/unskip", version=client.state()["version"])
    assert status == 200
    assert adviser.advise(path).skipped == opened.session.state.advice.skipped == ()
    assert client.post("/unskip", version=client.state()["version"])[0] == 422


def test_a_reading_with_a_remark_on_skips_is_a_reading(machine):
    opened, client, operator = machine
    take(client, operator.display(), remark="skipped breakfast")
    assert opened.session.state.advice.skipped == ()
    assert "skipped." not in client.state()["parts"]["pose"]


def test_a_job_s_error_is_shown_below_its_stages(tmp_path):
    """A command that prints stages, then fails: its error reaches the page."""
    job = BackgroundCommand()
    readings = tmp_path / "none.csv"
    command = ["identify", "planar_step_calibration", "--readings", readings]
    job.start("identify", [*command, "--out", tmp_path / "out"])
    while job.state.runs:
        time.sleep(0.05)
    assert job.state.code == 2
    assert any("none.csv" in line for line in job.state.lines)


def page_of(tmp_path: Path, lines: str) -> Any:
    """A served page of the small study with further lines in its set-up."""
    study = tmp_path / "mine.study.toml"
    stated = ("length_mm = 300.0\n", f"length_mm = 300.0\n{lines}")
    study.write_text(sample.changed(page_server.STUDY, stated), encoding="utf-8")
    return page_server.served(study, server.PageOptions(tmp_path / "poses.csv"))


def chosen(part: str) -> str:
    """The sign that the entry of a page's part has selected."""
    selected = part.partition(" selected")[0] if " selected" in part else '=""'
    return selected.rpartition('="')[2].rstrip('"')


def test_the_side_is_said_and_its_sign_written(machine):
    """Backlash of the head shows from both sides only; nothing is noted by itself."""
    opened, client, operator = machine
    part = client.state()["parts"]["pose"]
    assert "z grows over the last stretch: direction +1" in part
    assert "backlash" in part
    assert chosen(part) == ""
    _, state = take(client, operator.display(), direction="+1")
    assert "z falls over the last stretch: direction \u22121" in state["parts"]["pose"]
    assert "direction +1</li>" in state["parts"]["pose"]
    take(client, operator.display(), direction="-1")
    _, state = take(client, operator.display())
    written = rows(opened.session.log.path)
    assert [row["direction"] for row in written] == ["1", "-1", ""]
    assert "z grows" in state["parts"]["pose"]
    taken = opened.session.state.fitted.state.resolved.dataset
    assert taken.covariates["direction"].tolist()[:2] == [1.0, -1.0]


def test_an_undone_reading_does_not_count(machine):
    _, client, operator = machine
    take(client, operator.display(), direction="+1")
    _, state = client.post("/undo", version=client.state()["version"])
    assert "z grows" in state["parts"]["pose"]


@pytest.mark.parametrize("word", ["1", "0", "+2", "=1+1", "<b>"])
def test_another_sign_is_refused(machine, word):
    opened, client, operator = machine
    status, answer = take(client, operator.display(), direction=word)
    assert status == 422
    assert "direction" in answer["error"]
    assert not opened.session.log.path.exists()


def test_passes_both_ways_are_told_apart(tmp_path):
    """Each pose read from both sides: no run pretends a path, no finding complains."""
    lines = "both_directions = true\naverage = false\n"
    with page_of(tmp_path, lines) as (opened, port):
        client, operator = page_server.Client(port), page_server.Operator(opened)
        signs = []
        for number in range(8):
            state = client.state()
            if number % 2:
                client.post("/repeat", version=state["version"], again=True)
                state = client.state()
            signs.append(chosen(state["parts"]["pose"]))
            status, _ = take(client, operator.display(), direction=signs[-1])
            assert status == 200
        assert signs == ["+1", "-1"] * 4
        written = rows(tmp_path / "poses.csv")
        assert [row["direction"] for row in written] == ["1", "-1"] * 4
        assert {row["run"] for row in written} == {"1"}
        poses = [(row["z_mm"], row["psi_deg"]) for row in written]
        assert poses[::2] == poses[1::2]
        assert opened.session.state.problem == ""
        findings = opened.session.state.advice.findings
        assert not [words for words in findings if "direction" in words]


def test_the_mean_of_both_directions_has_no_sign(tmp_path):
    with page_of(tmp_path, "both_directions = true\n") as (opened, port):
        client, operator = page_server.Client(port), page_server.Operator(opened)
        part = client.state()["parts"]["pose"]
        assert "enter the mean" in part
        assert "Direction of approach" not in part
        assert take(client, operator.display(), direction="+1")[0] == 422
        assert take(client, operator.display())[0] == 200
