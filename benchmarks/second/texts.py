"""Printed answers of random cases, to be read by somebody who does not know the truth.

    python -m benchmarks.second.texts answers --seed 7
    python -m benchmarks.second.texts truths

The first command draws 25 cases of each machine, takes five of each at random, and
diagnoses them as a user would: `oed diagnose` on a study folder. `NN.txt` has what the
command prints, and the text of the report's parts on the gap. The second one prints what
acts in each case.
"""

from __future__ import annotations

import argparse
import html.parser
import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.second import adapter, cases
from benchmarks.second.cases import Case
from oed.base.whole_file import whole_file

#: cases of each machine in the set, and those of them that are read
DRAWN, READ = 25, 5
#: sections of the report with the answer of a diagnosis
SECTIONS = ("causes", "gap", "second_visit")
#: elements that begin a line
BLOCKS = frozenset({"p", "li", "tr", "h2", "h3", "figcaption", "dt"})
#: elements that do not hold words
SILENT = frozenset({"script", "style", "svg"})
#: file of the set that says which case has which number
CHOSEN = "chosen.json"
#: kinds of noise laws by the label's name of their size, in units of the stated noise
LAW_SIZES = ("repeat_over_sigma", "ar_over_sigma")


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 bad input."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.second.texts", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    answers = commands.add_parser("answers", help="write the answers of 20 cases")
    answers.add_argument("--seed", type=int, default=1)
    answers.add_argument("--generator", type=Path, default=cases.GENERATOR)
    answers.set_defaults(run=_write_answers)
    truths = commands.add_parser("truths", help="print what acts in each case")
    truths.set_defaults(run=_print_truths)
    for command in (answers, truths):
        command.add_argument("--out", type=Path, default=Path("out/second/texts"))
    return parser


# -- answers ---------------------------------------------------------------------------


def _write_answers(options: argparse.Namespace) -> None:
    """Write NN.txt for each case that has none yet."""
    folder = options.out / "set"
    cases.generate(folder, options.seed, DRAWN, adapter.MACHINES, options.generator)
    numbered = {
        f"{number:02d}": case
        for number, case in enumerate(chosen(folder, options.seed), 1)
    }
    names = {number: (case.machine, case.name) for number, case in numbered.items()}
    _write(folder / CHOSEN, json.dumps(names, indent=1))
    for number, case in numbered.items():
        path = options.out / f"{number}.txt"
        if not path.is_file():
            _write(path, answer(case, folder / "studies" / number))


def _write(path: Path, content: str) -> None:
    with whole_file(path) as unfinished:
        unfinished.write_text(content, encoding="utf-8")


def chosen(folder: Path, seed: int) -> list[Case]:
    """Some cases of each machine, in random order."""
    rng = np.random.default_rng(seed)
    drawn = [
        Case(folder, machine, str(name))
        for machine in adapter.MACHINES
        for name in rng.choice(cases.names(folder, machine), READ, replace=False)
    ]
    return [drawn[k] for k in rng.permutation(len(drawn))]


def answer(case: Case, folder: Path) -> str:
    """What a user reads of a case that is diagnosed in `folder`."""
    study, readings = adapter.write_case(case.stem, folder)
    command = ["diagnose", str(study), "--readings", str(readings), "--allow-code"]
    completed = subprocess.run(
        [str(Path(sys.executable).with_name("oed")), *command, "--out", folder / "out"],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    path = folder / "out" / "report.html"
    if not path.is_file():
        raise ValueError(f"{study}: {completed.stderr}")
    printed = completed.stdout + completed.stderr
    report = path.read_text(encoding="utf-8")
    return f"{printed}\n{section_text(report)}\n"


class _SectionText(html.parser.HTMLParser):
    """Collects the words of some sections of a report."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self._is_inside = False
        self._silent = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "section":
            self._is_inside = dict(attrs).get("id") in SECTIONS
        self._silent += tag in SILENT
        if tag in BLOCKS:
            self.handle_data("\n")
        if tag in ("td", "th"):
            self.handle_data(" | ")

    def handle_endtag(self, tag: str) -> None:
        self._is_inside = self._is_inside and tag != "section"
        self._silent -= tag in SILENT

    def handle_data(self, data: str) -> None:
        if self._is_inside and not self._silent:
            self.words.append(data if data == "\n" else re.sub(r"\s+", " ", data))


def section_text(report: str) -> str:
    """The words of a report's parts on the gap, a paragraph or a table's row a line."""
    parser = _SectionText()
    parser.feed(report)
    lines = "".join(parser.words).splitlines()
    return "\n".join(line.strip() for line in lines if line.strip(" |"))


# -- truths ----------------------------------------------------------------------------


def _print_truths(options: argparse.Namespace) -> None:
    folder = options.out / "set"
    numbered = json.loads((folder / CHOSEN).read_text(encoding="utf-8"))
    for number, (machine, name) in numbered.items():
        label = cases.labels(folder, machine)[name]
        print(f"| {number} | {machine} | {truth(label)} |")


def truth(label: Mapping[str, Any]) -> str:
    """What acts in a case, with sizes as sqrt(lambda), and its noise."""
    effects = [_effect(effect) for effect in label["effects"]]
    law = label["law"]
    sizes = [f"{law[name]:.1f} of the stated" for name in LAW_SIZES if law.get(name)]
    noise = ", ".join([law["law"], *sizes])
    acting = "; ".join(effects) or "nothing"
    return f"{label['kind']}: {acting} | noise: {noise}"


def _effect(effect: Mapping[str, Any]) -> str:
    """An effect with its size, what explains it as well, and its places."""
    alike = [name for name in effect["classes"] or [] if name != effect["effect"]]
    rivals = f", or {', '.join(alike)}" if alike else ""
    rest = effect["given_other"] if "given_other" in effect else effect["out_of_span"]
    size = f"{effect['sqrt_lambda']:.1f}, given others {rest:.1f}"
    return f"{effect['effect']}{rivals} ({size}; {effect['where']})"


if __name__ == "__main__":
    sys.exit(main())
