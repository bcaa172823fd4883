"""Machines of one's own, the catalogue, times, and studies that `oed new` writes."""

import fnmatch
import re
import tomllib
from pathlib import Path

import pytest
import sample
from oracles import new_families

from pkm_studies import catalogue, study
from pkm_studies.base import InputError, Location
from pkm_studies.commands import main
from pkm_studies.drafts import read_time, write_draft
from pkm_studies.resolve import resolve
from pkm_studies.study import SCHEMAS, Study
from pkm_studies.user_code import Origin


def test_a_machine_from_a_file(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import dataclasses\n"
        "from pkm_models.machines.a3_head import machine as base\n"
        'machine = dataclasses.replace(base, name="mine")\n'
        "head = machine\n",
        encoding="utf-8",
    )
    for reference in ("mine.py", "mine.py:head", "./mine.py:machine"):
        text = sample.changed(sample.STUDY, ('"a3_head"', f'"{reference}"'))
        assert sample.resolved(text, tmp_path).machine.name == "mine"
    error = sample.refused(
        sample.STUDY, ('"a3_head"', '"mine.py:other"'), folder=tmp_path
    )
    assert "there is: base, machine, head" in str(error)


@pytest.mark.parametrize(("source", "words"), [
    ("1/0", "ZeroDivisionError"), ("(", "SyntaxError"), ("exit()", "SystemExit"),
])  # fmt: skip
def test_a_file_that_fails_is_refused(source, words, tmp_path):
    (tmp_path / "bad.py").write_text(source)
    assert words in str(
        sample.refused(sample.STUDY, ('"a3_head"', '"bad.py"'), folder=tmp_path)
    )


def test_an_instrument_that_cannot_read_the_machine_is_refused(tmp_path):
    error = sample.refused(
        sample.STUDY,
        ('instrument = "ball_bar"', 'instrument = "redundancy"'),
        folder=tmp_path,
    )
    assert (
        "it cannot read a3_head: it takes more joints than degrees of freedom"
        in str(error)
    )


@pytest.mark.parametrize("kind", catalogue.KINDS)
def test_the_catalogue_gives_its_sources(kind):
    entries = catalogue.listing(kind)
    assert all(e.name and e.about and e.source for e in entries)
    assert len({e.name for e in entries}) == len(entries)
    assert entries


def uncommented(text: str) -> str:
    """The text with the tables and fields that are commented out."""
    lines = []
    for line in text.splitlines():
        is_toml = fnmatch.fnmatch(line, "# [[a-z]*[]=]*")
        lines.append(line.removeprefix("# ") if is_toml else line)
    return "\n".join(lines)


#: instruments that read how a platform is turned, and machines that turn it
OF_ORIENTATION = ("home_orientation", "level", "autocollimator")
TURNING = (
    *("a3_head", "delta_printer", "hexaglide", "hexapod"),
    *("prs_spindle", "prs_spindle_struts"),
)
#: machines that turn with the tool point in a seat
TURNING_IN_A_SEAT = ("hexaglide", "hexapod")
#: instruments of passive joints, and machines that name none
OF_PASSIVE_JOINTS = ("passive_joint", "locked_joint")
#: machines whose workspace is drafted in a moment
SMALL = ("linear_delta", "planar_2dof", "micro_cmm")
CHECKED_ELSEWHERE = tuple(new_families.CLOSURES)
UNNAMED = (
    *("cable_robot", "delta_printer", "hexaglide", "planar_2dof"),
    "rotary_delta_printer",
)


def can_read(machine: str, instrument: str) -> bool:
    """Whether the instrument reads anything of the machine."""
    spare = machine == "cable_robot" or not instrument.startswith("redundancy")
    in_plane = (machine, instrument) != ("planar_2dof", "planar_position")
    turns = machine in TURNING or instrument not in OF_ORIENTATION
    moves = machine in TURNING_IN_A_SEAT or instrument != "seat"
    passive = machine not in UNNAMED or instrument not in OF_PASSIVE_JOINTS
    return spare and in_plane and turns and moves and passive


def _pairs() -> list[tuple[str, str]]:
    """Machines with instruments.

    Each instrument with one machine that it reads, small ones in turn; a sixth of those
    that it cannot read, and the planar one; families that test_families.py does not
    check, with one position reader.
    """
    tools = [entry.name for entry in catalogue.listing("instruments")]
    names = [entry.name for entry in catalogue.listing("machines")]
    location = Location("catalogue")
    families = [n for n in names if catalogue.machine(n, Origin(), location).family]
    machines = [n for n in names if n not in families]
    pairs = [(n, "camera_known_frame") for n in families if n not in CHECKED_ELSEWHERE]
    pairs.append(("planar_2dof", "planar_position"))
    for number, tool in enumerate(tools):
        turn = number % len(SMALL)
        in_turn = [*SMALL[turn:], *SMALL[:turn], *machines]
        pairs += [(m, tool) for m in in_turn if can_read(m, tool)][:1]
        pairs += [
            (machine, tool)
            for k, machine in enumerate(machines)
            if not can_read(machine, tool) and (k + number) % 6 == 0
        ]
    return list(dict.fromkeys(pairs))


@pytest.mark.parametrize(("machine", "instrument"), _pairs())
def test_a_new_study_is_sound(machine, instrument, tmp_path):
    if not can_read(machine, instrument):
        with pytest.raises(InputError, match=f"it cannot read {machine}"):
            write_draft("fresh", machine, instrument, Origin(tmp_path))
        assert not list(tmp_path.iterdir())
        return
    path = write_draft("fresh", machine, instrument, Origin(tmp_path))
    drafted = path.read_text(encoding="utf-8")
    filled = drafted.replace('"to be measured"', "0.0")
    if filled != drafted:
        with pytest.raises(InputError, match=r"setup\[1\]\.at\w+ .*measure it"):
            study.Study.load(path)
        path.write_text(filled, encoding="utf-8")
    resolved = resolve(study.Study.load(path))
    assert 20 <= len(resolved.candidates[0]) <= 1000
    assert len(resolved.prediction.command) <= 1000
    text = path.read_text(encoding="utf-8")
    sample.resolved(uncommented(text), tmp_path)
    with pytest.raises(InputError, match="of this name"):
        write_draft("fresh", machine, instrument, Origin(tmp_path))


def test_what_a_draft_leaves_open_is_refused_by_name(tmp_path, monkeypatch, capsys):
    """A gimbal that nobody measured stands nowhere: not at the base frame's origin."""
    monkeypatch.chdir(tmp_path)
    new = ["new", "open", "--machine", "a3_head", "--instrument", "laser_ball_bar"]
    assert main(new) == 0
    assert 'where it says "to be measured"' in capsys.readouterr().out
    path = Path("open.study.toml")
    text = path.read_text(encoding="utf-8")
    names = ["at_x_mm", "at_y_mm", "at_z_mm"]
    assert re.findall(r'^(\w+) = "to be measured"', text, re.M) == names
    for name in names:
        for command in (["check", path.name], ["run", path.name, "--out", "o"]):
            assert main(command) == 2
            error = capsys.readouterr().err
            assert f"open.study.toml: setup[1].{name}" in error
            assert "measure it at your machine" in error
        text = text.replace(f'{name} = "to be measured"', f"{name} = 900.0")
        path.write_text(text, encoding="utf-8")
    assert not Path("o").exists()
    assert main(["check", path.name]) == 0


def test_a_draft_states_the_noise_once(tmp_path):
    """Of a laser ball bar by its range and angles; of others by channel."""
    noise = {}
    for tool in ("laser_ball_bar", "ball_bar"):
        path = write_draft(tool, "a3_head", tool, Origin(tmp_path))
        noise[tool] = tomllib.loads(path.read_text(encoding="utf-8"))
    assert "noise" not in noise["laser_ball_bar"]
    assert noise["laser_ball_bar"]["setup"][0]["range_noise_mm"] == 0.0003
    assert noise["ball_bar"]["noise"] == {"length_um": 0.5}


def test_any_number_of_a_study_may_be_open(tmp_path):
    """The mark of a draft is refused wherever it stands, with its place."""
    for old, location in (
        ("length_um = ", "noise.length_um"),
        ("length_mm = ", "setup[1].length_mm"),
    ):
        line = re.search(rf"^{old}.*$", sample.STUDY, re.M)
        opened = (line[0], f'{old}"to be measured"')
        error = sample.refused(sample.STUDY, opened, folder=tmp_path)
        assert f": {location} = " in str(error)
        assert "leaves this number open" in str(error)


@pytest.mark.parametrize("family", ["delta", "hexapod_pus", "cables_spatial"])
def test_a_drafted_geometry_describes_the_machine_of_the_model(family, tmp_path):
    """With the comment signs removed, the table is complete and changes nothing."""
    path = write_draft("fresh", family, "pose_tracker_position", Origin(tmp_path))
    entry = re.compile(r"^# (\[machine\.geometry\]|\w+ = .*  # .*)", re.M)
    text = path.read_text()
    start, end = text.index("# [machine.geometry]"), text.index("# [machine.nominal]")
    table = entry.sub(r"\1", text[start:end])
    drafted = text[:start] + table + text[end:]
    assert "\n[machine.geometry]" in drafted
    machine = sample.resolved(drafted, tmp_path).machine
    model = catalogue.machine(family, Origin(), Location("test"))
    for given, wanted in zip(machine.parameters, model.parameters, strict=True):
        assert given.nominal == pytest.approx(wanted.nominal, abs=1e-9)
    for dimension in model.family.dimensions:
        assert f"# {dimension.name}" in text[start:end]


def test_the_schema_knows_tables_with_fields_of_free_name():
    schema = SCHEMAS["study"]()
    table = schema["$defs"]["SetupTable"]
    assert table["additionalProperties"] == {"type": "number"}
    assert "settings" not in table["properties"]
    assert schema["$defs"]["DesignTable"]["additionalProperties"] is False


#: machines whose ranges say more than they reach, and one whose joints reach little
REACH_LESS = """
import dataclasses
from pkm_models.machines import hexapod, linear_delta

def ranged(machine, name, factor):
    ends = [(factor * c.lower, factor * c.upper) for c in machine.command]
    command = [
        dataclasses.replace(c, lower=low, upper=high)
        for c, (low, high) in zip(machine.command, ends)
    ]
    return dataclasses.replace(machine, name=name, command=tuple(command))

big = ranged(linear_delta.machine, "big", 2.0)
narrow = dataclasses.replace(
    hexapod.machine,
    name="narrow",
    joints=tuple(
        dataclasses.replace(c, lower=0.57, upper=0.68) for c in hexapod.machine.joints
    ),
)
nowhere = dataclasses.replace(
    hexapod.machine,
    name="nowhere",
    joints=tuple(
        dataclasses.replace(c, lower=0.1, upper=0.2) for c in hexapod.machine.joints
    ),
)
"""


@pytest.mark.parametrize("name", ["big", "narrow"])
def test_a_draft_of_a_machine_that_reaches_less_than_its_ranges_is_sound(
    name, tmp_path, monkeypatch
):
    """It keeps to a smaller part about home."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(REACH_LESS, "utf-8")
    assert main(["new", "--machine", f"mine.py:{name}"]) == 0
    assert main(["check", f"{name}.study.toml"]) == 0


def test_what_no_draft_can_do_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(REACH_LESS, "utf-8")
    assert main(["new", "--machine", "mine.py:nowhere"]) == 2
    error = capsys.readouterr().err
    assert re.search(r"the pose x = \S+ mm, y = \S+ mm, .*needs q1 = \S+ mm", error)
    assert not (tmp_path / "nowhere.study.toml").exists()


def test_a_study_is_drafted_from_a_machine_file_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.py").write_text(
        "import dataclasses\n"
        "from pkm_models.machines.linear_delta import machine as base\n"
        'machine = dataclasses.replace(base, name="my_delta")\n'
    )
    assert main(["new", "--machine", "my.py"]) == 0
    assert "Instrument: pose_tracker; it can also be read by" in capsys.readouterr().out
    assert main(["check", "my_delta.study.toml"]) == 0
    assert main(["new", "--machine", "my.py"]) == 2  # nothing is overwritten
    assert main(["new", "--from", "a3_ball_bar"]) == 2


@pytest.mark.parametrize(("text", "hours"), [
    ("90", 1.5), ("90 min", 1.5), ("two days", 16.0), ("1,5 h", 1.5), ("2d", 16.0),
    ("half a day", 4.0), ("a half hour", 0.5), ("a week", 40.0),
    ("two and a half hours", 2.5), ("One Hour", 1.0),
])  # fmt: skip
def test_a_time_as_one_says_it(text, hours):
    """By hand; a day has eight hours at the machine, a week five days."""
    assert read_time(text) == pytest.approx(3600.0 * hours)


@pytest.mark.parametrize("text", ["soon", "", "-3 h", "3 parsecs", "1e9 h" * 20])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(InputError, match="two days"):
        read_time(text)


@pytest.mark.parametrize("machine", ["five_bar", "rotary_delta", "hexapod"])
def test_a_drafted_bar_fits_the_workspace_and_its_readings_the_unknowns(
    machine, tmp_path, capsys
):
    """The bar of 300 mm is longer than these workspaces, whose cup is taught inside."""
    path = write_draft("bar", machine, "ball_bar", Origin(tmp_path))
    assert main(["check", str(path)]) == 0
    assert "but it holds" not in capsys.readouterr().out
    length = re.search(r"^length_mm = (\S+)", path.read_text(), re.MULTILINE)
    assert 10.0 <= float(length[1]) <= 200.0


def test_a_draft_has_the_readings_of_its_time(tmp_path):
    """Mounting and readings by the instrument's own times, counted here."""
    origin = Origin(tmp_path)
    tool = catalogue.instrument("pose_tracker_position", origin, Location("test"))
    seconds = tool.cost.setup + 40.5 * tool.cost.reading
    path = write_draft("timed", "delta", "pose_tracker_position", origin, seconds)
    design = Study.load(path).design
    assert design.size == 40


def test_too_short_a_time_is_refused(tmp_path):
    with pytest.raises(InputError, match="too short"):
        write_draft("timed", "delta", "pose_tracker_position", Origin(tmp_path), 60.0)
    assert list(tmp_path.iterdir()) == []
