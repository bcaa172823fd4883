"""No string of stored data leads to an import: results, campaigns, checkpoints, maps,
readings.

Each test puts the name of a module or a file that is there, and could be imported, in
place of any string of the data. An audit hook sees every import and every execution of
code in this process, whichever way they come about.
"""

import contextlib
import copy
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import compensation_sample
import msgspec
import numpy as np
import pytest
import report_fixture
import sample
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from shipped_models import linear_delta

from oed.posterior import Checkpoint
from pkm_studies import result_folder
from pkm_studies.base import InputError
from pkm_studies.commands import main

NAME = "pkm_canary"
#: modules and files that lie where data might lead to: all exist
REFERENCES = (
    f"{NAME}.py", f"{NAME}.py:machine", f"./{NAME}.py:figures",
    f"below/{NAME}.py:machine", f"../{NAME}.py:machine",
    f"{{folder}}/{NAME}.py:machine", f"{NAME}:machine", f"{NAME}:figures", f"{NAME}",
    f"{NAME}_package.inner:machine", f"{NAME}_package.inner",
)  # fmt: skip
EXAMPLES = settings(
    max_examples=12,
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # an example says enough
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
CANARY = "from pkm_models.machines.linear_delta import machine\ndef figures(s, n): return {}\n"

CAMPAIGN = """\
schema = 1
name = "own"
title = "mine"
case = "case"
summary = "summary"
seeds = 1

[vary]
field = ["value"]
"""
STUDY_CAMPAIGN = """\
schema = 1
name = "own"
study = "small.study.toml"
seeds = 1

[vary]
"machine.model" = ["linear_delta", "linear_delta"]
"setup.probe.instrument" = ["height_probe"]
"""
STUDY = (
    sample.DELTA.partition('[[setup]]\nname = "calliper"')[0]
    + "[prediction]\nx_mm = 0.0\ny_mm = 0.0\nz_mm = [0.0, 20.0]\n"
)
MAP = """\
machine = "linear_delta"
instrument = "height_probe"
setup = "s"

[columns]
x_mm = "x"
y_mm = "y"
z_mm = "z"
height_mm = "h"
"""


class Watch:
    """What was imported or executed that the data named; one hook a process."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.active = False
        sys.addaudithook(self._see)

    def _see(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.active or event not in ("import", "exec", "compile"):
            return
        name = arguments[0] if event == "import" else _file(arguments)
        if NAME in str(name):
            self.names.append(f"{event} {name}")


def _file(arguments: tuple[Any, ...]) -> object:
    """File of the code that is executed, or compiled."""
    return getattr(arguments[0], "co_filename", arguments[-1])


WATCH = Watch()


@contextlib.contextmanager
def nothing_runs(where: Path) -> Iterator[None]:
    """Fails where anything that the data named is imported within the block."""
    WATCH.names.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("OED_TRUSTED_FOLDERS")
        patch.chdir(where)
        patch.syspath_prepend(str(where))  # the names could be imported
        WATCH.active = True
        try:
            yield
        finally:
            WATCH.active = False
    assert not WATCH.names


@contextlib.contextmanager
def field() -> Iterator[Path]:
    """A folder with canaries wherever a name might lead from its folder `data`."""
    with tempfile.TemporaryDirectory() as name:
        data = Path(name).resolve() / "data"
        inner = data / f"{NAME}_package"
        for folder in (data, data / "below", inner):
            folder.mkdir()
        files = [place / f"{NAME}.py" for place in (data, data.parent, data / "below")]
        for path in (*files, inner / "__init__.py", inner / "inner.py"):
            path.write_text(CANARY, "utf-8")
        yield data


def strings(tree: Any) -> list[tuple[Any, Any]]:
    """Container and key of every string in nested tables and lists."""
    found: list[tuple[Any, Any]] = []
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in pairs:
        if isinstance(value, str):
            found.append((tree, key))
        elif isinstance(value, dict | list):
            found += strings(value)
    return found


def replace_some(tree: Any, draw: st.DataObject, folder: Path) -> None:
    """Replace one to three strings of a tree by references."""
    places = strings(tree)
    for _ in range(draw.draw(st.integers(1, 3))):
        container, key = draw.draw(st.sampled_from(places))
        reference = draw.draw(st.sampled_from(REFERENCES))
        container[key] = reference.replace("{folder}", folder.as_posix())


def changed_toml(text: str, draw: st.DataObject, folder: Path) -> str:
    table = tomllib.loads(text)
    replace_some(table, draw, folder)
    return msgspec.toml.encode(table).decode()


def call(*arguments: object) -> int:
    """The command; whatever it raises beyond exit codes fails the test."""
    code = main([str(a) for a in arguments])
    assert code in (0, 1, 2)
    return code


def test_the_watch_sees_each_way_to_run_code(tmp_path):
    """Otherwise the tests below could not fail."""
    import importlib
    import runpy

    path = tmp_path / f"{NAME}_seen.py"
    path.write_text("x = 1\n", "utf-8")
    for run in (
        lambda: runpy.run_path(str(path)),
        lambda: exec(compile("x = 1", str(path), "exec")),
        lambda: importlib.import_module(path.stem),
    ):
        with pytest.raises(AssertionError), nothing_runs(tmp_path):
            run()


@settings(EXAMPLES, max_examples=12)
@given(st.data())
def test_results(draw):
    """The study within is data too: its model, instruments and effects."""
    machine = linear_delta.machine
    content = compensation_sample.result(machine, machine.nominal)
    plain = msgspec.to_builtins(content)
    with field() as folder:
        if draw.draw(st.booleans()):
            replace_some(plain, draw, folder)
        else:
            text = plain["study_text"]
            plain["study_text"] = changed_toml(text, draw, folder)
        encoded = msgspec.json.encode(plain)
        for name in ("a", "b"):
            (folder / name).mkdir()
            (folder / name / "result.json").write_bytes(encoded)
        with nothing_runs(folder):
            call("compensate", "a", "--to", "csv", "--allow-code")
            call("verify", "a", "--allow-code")
            call("history", "a", "b", "--allow-code")
            call("compare", "a", "b")


@settings(EXAMPLES, max_examples=2)
@given(st.data())
def test_reports(draw):
    plain = copy.deepcopy(report_fixture.sample())  # its parts are others' too
    with field() as folder:
        replace_some(plain, draw, folder)
        (folder / "result.json").write_bytes(msgspec.json.encode(plain))
        with nothing_runs(folder), contextlib.suppress(InputError):
            result_folder.write_report(folder, pdf=False)


@EXAMPLES
@given(st.data())
def test_campaigns(draw):
    with field() as folder:
        (folder / "small.study.toml").write_text(STUDY, "utf-8")
        text = draw.draw(st.sampled_from([CAMPAIGN, STUDY_CAMPAIGN]))
        file = folder / "own.campaign.toml"
        file.write_text(changed_toml(text, draw, folder), "utf-8")
        with nothing_runs(folder):
            assert call("campaign", file, "--out", folder / "out", "--workers", 1) in (
                0,
                2,
            )


@EXAMPLES
@given(st.data())
def test_checkpoints(draw):
    """Names of arrays, and strings in them, also such as only a pickle holds."""
    reference = draw.draw(st.sampled_from(REFERENCES))
    with field() as folder:
        checkpoint = Checkpoint(folder / "unfinished", "key")
        strings = np.array(reference, dtype=draw.draw(st.sampled_from([str, object])))
        checkpoint.save({"fingerprint": strings, reference: np.zeros(2)})
        with nothing_runs(folder):
            checkpoint.load()


@EXAMPLES
@given(st.data())
def test_column_maps(draw):
    with field() as folder:
        (folder / "a.csv").write_text("x,y,z,h\n0,0,10,0.02\n50,0,10,0.01\n", "utf-8")
        (folder / "map.toml").write_text(changed_toml(MAP, draw, folder), "utf-8")
        with nothing_runs(folder):
            call("import", "columns", "a.csv", "--map", "map.toml", "--out", "out")


@EXAMPLES
@given(st.data())
def test_readings(draw):
    """Names of set-ups, runs and columns, and any other cell."""
    rows = [line.split(",") for line in sample.READINGS.splitlines()]
    with field() as folder:
        replace_some(rows, draw, folder)
        (folder / "s.study.toml").write_text(sample.STUDY, "utf-8")
        text = "\n".join(",".join(row) for row in rows)
        (folder / "r.csv").write_text(text, "utf-8")
        with nothing_runs(folder):
            call("check", "s.study.toml", "r.csv", "--allow-code")
