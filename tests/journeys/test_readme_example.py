"""The README's first example, to the file that a controller reads."""

import csv
import re
import shlex
from pathlib import Path

import sample

from pkm_studies.commands import main

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def example() -> list[str]:
    """Commands of the README's first console block."""
    block = BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))[0]
    return [line.removeprefix("$ ") for line in block.splitlines()]


def as_oed(command: str) -> list[str]:
    """Arguments of `oed` in a command; `make study` is what the Makefile runs."""
    if command == "make study":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        recipe = re.search(r"^study:.*\n\t\$\(BIN\)/(.*)$", makefile, re.MULTILINE)
        default = re.search(r"^STUDY := (\w+)$", makefile, re.MULTILINE)
        name = default.group(1)
        command = recipe.group(1).replace(
            "studies/$(STUDY)", str(ROOT / "studies" / name)
        )
        command = command.replace("$(STUDY)", name)
    program, *arguments = shlex.split(command)
    assert Path(program).name == "oed"
    return arguments


def run_example(study: Path) -> None:
    """Run the example with a study file in place of the README's."""
    name = study.name.removesuffix(".study.toml")
    shipped = str(ROOT / "studies" / "a3_ball_bar.study.toml")
    for command in example():
        given = [a.replace(shipped, str(study)) for a in as_oed(command)]
        assert main([a.replace("a3_ball_bar", name) for a in given]) == 0


def rows(folder: Path) -> list[dict[str, str]]:
    """Rows of the file that the controller reads, without its comments."""
    text = (folder / "compensation.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def test_the_example_ends_with_the_file_that_a_controller_reads(tmp_path, monkeypatch):
    """With a study of seconds in the place of the README's."""
    monkeypatch.chdir(tmp_path)
    text = sample.changed(
        sample.STUDY,
        ("[[design.candidates]]", '[[design.reference]]\nname = "circles"'),
        (
            "[expect]",
            "[posterior]\nenabled = false\n[readings]\nsimulate = true\n[expect]",
        ),
    )
    study = tmp_path / "small.study.toml"
    study.write_text(text, encoding="utf-8")
    run_example(study)
    assert example()[-1].split()[1] == "compensate"
    written = rows(tmp_path / "out" / "small")
    assert len(written) > 5
    assert any("q1" in name for name in written[0])
