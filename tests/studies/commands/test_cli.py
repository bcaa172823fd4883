"""The command: what it prints, its exit codes, and that it leaves whole files only."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import sample
from few_poses import PLAN, write
from fresh_process import printed_by

from pkm_studies import catalogue, files
from pkm_studies.base import InputError

pytestmark = pytest.mark.usefixtures("own_folder")


def children_seconds() -> float:
    """Processor time of the processes that ended."""
    times = os.times()
    return times.children_user + times.children_system


def test_help_is_there_at_once():
    """0.5 s of a processor: the best of three, as other work may share the machine."""
    times = []
    for _ in range(3):
        start = children_seconds()
        done = subprocess.run(
            [sys.executable, "-m", "pkm_studies.commands.cli", "--help"],
            capture_output=True,
            check=True,
        )
        times.append(children_seconds() - start)
    assert b"identify" in done.stdout
    assert min(times) <= 0.5


def test_a_command_of_its_own_process_leaves_no_garbage_to_look_for():
    """Python would look through all that is alive at its end."""
    code = (
        "import gc, sys; from pkm_studies.commands import cli;"
        " cli.main(['--help']); before = gc.get_freeze_count();"
        " sys.argv = ['oed', '--help']; cli.main();"
        " print(before, gc.get_freeze_count() > 10_000)"
    )
    assert printed_by(code)[-1] == "0 True"


def test_help_imports_nothing_heavy():
    heavy = {"numpy", "casadi", "pandas", "rich.console"}
    code = f"import sys, pkm_studies.commands.cli; sys.exit(len({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_lists_load_nothing_that_computes():
    """In one process: what any of the lists loads stays loaded."""
    heavy = ["pandas", "scipy.spatial", "scipy.sparse", "scipy.optimize", "matplotlib"]
    heavy += ["oed.result", "pkm_studies.commands.new", "pkm_studies.resolve.machine"]
    code = (
        "import sys; from pkm_studies.commands import cli;"
        " kinds = ['machines', 'instruments', 'effects', 'studies'];"
        " print([cli.main(['list', kind]) for kind in kinds]);"
        f" print(sorted(set({heavy}) & set(sys.modules)))"
    )
    assert printed_by(code)[-2:] == ["[0, 0, 0, 0]", "[]"]


def test_checks_load_no_statistics_and_no_searches():
    """They would take twice as long as all else that a check imports."""
    heavy = {
        "scipy.optimize",
        "scipy.special",
        "scipy.stats",
        "scipy.spatial",
        "pandas",
    }
    heavy |= {"oed.gap.procedure", "oed.posterior", "oed.planning.search"}
    heavy |= {"oed.effects.columns", "pkm_studies.stages.design.select"}
    code = (
        "import sys; from pkm_studies.commands import cli;"
        f" cli.main(['check', 'planar_plan']); print({heavy} & set(sys.modules))"
    )
    assert printed_by(code)[-1] == "set()"


@pytest.mark.parametrize("command", [
    "run", "check", "simulate", "identify", "report", "list", "schema", "new",
])  # fmt: skip
def test_every_command_has_help(command, oed):
    code, out, _ = oed(command, "--help")
    assert code == 0
    assert out.startswith(f"Usage: oed {command}")


@pytest.mark.parametrize("kind", catalogue.KINDS)
def test_list(kind, oed):
    code, out, _ = oed("list", kind)
    assert code == 0
    code, as_json, _ = oed("list", kind, "--json")
    entries = json.loads(as_json)
    assert [line.split()[0] for line in out.splitlines()] == [
        e["name"] for e in entries
    ]
    one = entries[0]
    code, out, _ = oed("list", kind, one["name"])
    assert code == 0
    assert one["source"] in out
    code, _, errors = oed("list", kind, f"{one['name']}x")
    assert code == 2
    assert f"did you mean {one['name']}?" in errors


@pytest.mark.parametrize("of", ["study", "result", "readings"])
def test_schema(of, oed):
    code, out, _ = oed("schema", of)
    assert code == 0
    assert json.loads(out)["$schema"].startswith("https://json-schema.org")


def test_new_is_sound(oed, tmp_path):
    code, out, _ = oed(
        "new", "mine", "--machine", "a3_head", "--instrument", "ball_bar"
    )
    assert code == 0
    assert "oed run mine.study.toml" in out
    assert oed("check", "mine.study.toml")[0] == 0
    assert (
        oed("new", "mine", "--machine", "a3_head", "--instrument", "ball_bar")[0] == 2
    )
    assert oed("new", "a/b", "--machine", "a3_head", "--instrument", "ball_bar")[0] == 2
    assert [p.name for p in tmp_path.iterdir()] == ["mine.study.toml"]


def test_check_reads_readings_with_their_study(oed, tmp_path):
    study = write(tmp_path / "a.study.toml", sample.STUDY)
    good = write(tmp_path / "good.readings.csv", sample.READINGS)
    bad = write(
        tmp_path / "bad.readings.csv", sample.READINGS.replace("1146,0", "11460,0")
    )
    code, out, _ = oed("check", study, good)
    assert code == 1  # at these poses no machine within its tolerances reads 300 mm
    assert "48 candidates" in out
    assert "3 readings fit the columns of small" in out
    assert "rows 2, 5" in out
    assert "sound as text" in oed("check", bad)[1]
    code, out, err = oed("check", study, bad, good)
    assert code == 2
    assert err.count("\n") == 1
    assert "bad.readings.csv: row 2, column z_mm" in err
    assert "3 readings fit the columns of small" in out


def test_readings_of_a_study_with_an_error_are_checked_as_text(oed, tmp_path):
    study, readings = tmp_path / "a.study.toml", tmp_path / "r.csv"
    study.write_text(sample.STUDY.replace("a3_head", "a3_hed"), encoding="utf-8")
    readings.write_text(sample.READINGS, encoding="utf-8")
    code, out, err = oed("check", study, readings)
    assert code == 2
    assert "did you mean a3_head?" in err
    assert "4 rows are sound as text; set-ups, poses and units are checked once" in out
    assert "give the study" not in out
    assert "give the study as well" in oed("check", readings)[1]


def test_check_says_where_data_is_missing(oed, tmp_path):
    study = write(
        tmp_path / "d.study.toml",
        sample.DELTA + '[readings]\nsource = "delta_v400"\npath = "gone"\n',
    )
    code, out, _ = oed("check", study)
    assert code == 0
    assert "looked in" in out


def test_run_prints_headline_claims_and_files(oed, tmp_path):
    study = write(tmp_path / "p.study.toml", PLAN)
    code, out, err = oed("run", study)
    assert (code, err) == (0, "")
    assert "Claims: 1 of 1 met." in out
    assert "18 of 21" in out
    assert (
        json.loads((tmp_path / "out/small/result.json").read_text())["identifiability"][
            "rank"
        ]
        == 18
    )
    # one line a stage where stderr is no terminal
    assert "identifiability" in out.splitlines()
    code, out, err = oed("run", study, "--quiet", "--out", "there", "--seed", "3")
    assert (code, out, err) == (0, "", "")
    assert json.loads((tmp_path / "there/result.json").read_text())["seed"] == 3


def test_a_failing_claim_exits_1(oed, tmp_path):
    study = write(
        tmp_path / "p.study.toml", sample.changed(PLAN, ("equals = 18", "equals = 21"))
    )
    code, out, err = oed("run", study, "--quiet", "--out", "x")
    assert (code, out) == (1, "")
    assert err == "oed: claim rank: not met: identifiability.rank = 21, measured 18\n"


def test_simulated_readings_can_be_identified(oed, tmp_path):
    text = (
        PLAN
        + "[readings]\nsimulate = true\ntruth = { dq1_mm = 1.5 }\n[posterior]\nenabled"
        ' = false\n[identify]\neffects = "none"\n'
    )
    study = write(tmp_path / "p.study.toml", text)
    code, out, _ = oed("simulate", study, "--out", "new/r.readings.csv")
    assert code == 0
    assert "r.truth.json" in out
    assert json.loads((tmp_path / "new/r.truth.json").read_text())["dq1"][
        "value"
    ] == pytest.approx(1.5e-3)
    code, _, _ = oed(
        "identify", study, "--readings", "new/r.readings.csv", "--out", "out", "--quiet"
    )
    assert code == 0
    estimate = json.loads((tmp_path / "out/result.json").read_text())["estimate"]
    assert estimate["readings"] == 30
    assert estimate["rms_after"]["length"] < 0.01 * estimate["rms_before"]["length"]
    code, _, err = oed("identify", study, "--readings", "gone.csv", "--out", "other")
    assert code == 2
    assert "gone.csv" in err
    assert not (tmp_path / "other").exists()


def test_a_report_again(oed, tmp_path):
    assert oed("report", "nowhere")[0] == 2
    write(tmp_path / "result.json", '{"schema": 1}')
    code, _, err = oed("report", ".")
    assert code == 2
    assert "no result" in err


def test_one_seed_gives_the_same_bytes(oed, tmp_path):
    study = write(
        tmp_path / "p.study.toml",
        PLAN + "[readings]\nsimulate = true\n[posterior]\nenabled = false\n",
    )
    texts = []
    for folder in ("a", "b"):
        assert oed("run", study, "--quiet", "--out", folder)[0] == 0
        lines = (tmp_path / folder / "result.json").read_text().splitlines()
        texts.append([line for line in lines if '"seconds"' not in line])
    assert texts[0] == texts[1]


# -- how it ends -----------------------------------------------------------------------
@pytest.mark.parametrize("arguments", [
    ["run"],
    ["frobnicate"],
    ["run", "a", "--seed", "x"],
    ["run", "a", "--seed", "-1"],
    ["run", "a", "--fast"],
    ["list", "x"],
    ["list"],
])  # fmt: skip
def test_a_wrong_call_gets_one_line(arguments, oed):
    code, out, err = oed(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.endswith("see `oed --help`.\n")
    assert "Value error" not in err


def test_a_misspelt_command_is_asked_about_in_one_sentence(oed):
    code, _, err = oed("diagnos")
    assert code == 2
    assert err == (
        "oed: No such command 'diagnos' (did you mean 'diagnose'?); see `oed --help`.\n"
    )


def test_no_command_gets_the_help(oed):
    code, out, err = oed()
    assert (code, out) == (2, "")
    assert err.startswith("Usage: oed [OPTIONS] COMMAND")


@pytest.mark.skipif(os.name == "nt", reason="one process cannot be sent Ctrl-C")
def test_interrupted_in_earnest(tmp_path):
    """SIGINT in the middle of work: one line, and whole files only."""
    text = (
        sample.STUDY
        + "[readings]\nsimulate = true\n[posterior]\nsteps = 1000000\ness = 1000000\n"
    )
    study = write(tmp_path / "p.study.toml", text)
    # as from a terminal: a shell in the background has tests ignore the signal
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
        " import sys; "
    )
    code += "from pkm_studies.commands.cli import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "run", str(study), "--out", str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if line.strip() == "posterior":
            break
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    try:
        _, err = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:  # close its pipes before the next test
        process.kill()
        process.communicate()
        raise
    assert process.returncode == 130
    assert err == "oed: interrupted: files written so far are whole\n"
    remaining = (
        list((tmp_path / "out").rglob("*")) if (tmp_path / "out").exists() else []
    )
    assert not [p for p in remaining if p.suffix == ".part" or p.name == "result.json"]


def test_a_reader_that_goes_away_is_no_error():
    code = (
        "import sys, os; os.close(sys.stdin.fileno()); from pkm_studies.commands.cli import"
        " main; sys.exit(main())"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, "schema", "result"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")


def test_files_are_written_whole(tmp_path, monkeypatch):
    path = files.write_whole(tmp_path / "a/b.txt", "old")

    def broken(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", broken)
    with pytest.raises(OSError, match="No space"):
        files.write_whole(path, b"new")
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == ["b.txt"]
    for taken in (path.parent, path / "below"):
        with pytest.raises(InputError, match="in the way"):
            files.write_whole(taken, "x")


def test_the_folder_must_be_one(oed, tmp_path):
    study = write(tmp_path / "p.study.toml", PLAN)
    code, _, err = oed("run", study, "--out", study)
    assert code == 2
    assert "in the way" in err
