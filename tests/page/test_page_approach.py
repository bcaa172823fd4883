"""The direction of approach on the page: what it says, what it writes, passes both ways."""

from pathlib import Path
from typing import Any

import pytest
import sample

from page import page_server
from page.page_server import rows, take
from pkm_page import server


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
