"""Printed answers of random cases, to be read by somebody who does not know the truth.

    python -m benchmarks.second.texts answers --seed 7
    python -m benchmarks.second.texts truths

The first command draws 25 cases of each machine, takes five of each at random, and
diagnoses them as `oed diagnose` does. `NN.txt` has what the command prints of it, and the
words of the report's chapters on the gap. The second one prints what acts in each case.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.exit_code import exit_code
from benchmarks.second import adapter, cases
from benchmarks.second.cases import Case
from oed import trust
from oed.result import StudyResult
from oed.safe_files import whole_file
from pkm_reports import sections
from pkm_reports.blocks import Block, Items, Notice, Paragraph, Picture, Table
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.user_code import Consent

#: cases of each machine in the set, and those of them that are read
DRAWN, READ = 25, 5
#: chapters of a report on the gap
GAP_CHAPTERS = ("gap", "second_visit")
#: file of the set that says which case has which number
CHOSEN = "chosen.json"
#: kinds of noise laws by the label's name of their size, in units of the stated noise
LAW_SIZES = ("repeat_over_sigma", "ar_over_sigma")


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 bad input."""
    return exit_code(_parser(), arguments)


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


def _write_answers(options: argparse.Namespace) -> int:
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
            _write(path, answer(diagnosis(case, folder / "studies" / number)))
    return 0


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


def diagnosis(case: Case, folder: Path) -> StudyResult:
    """The result of `oed diagnose` of a case, without the accuracy of a correction."""
    path, readings = adapter.write_case(case.stem, folder)
    study = studies.load(path, Consent.GIVEN)
    fitted = stages.fit_checked(stages.recorded(study, [readings]))
    return stages.result_so_far(stages.diagnose_always(fitted))


def answer(result: StudyResult) -> str:
    """What a user reads: the command's findings, and the report's chapters.

    Of a figure it is the caption.
    """
    chapters = [c for c in sections.chapters(result) if c.anchor in GAP_CHAPTERS]
    blocks = [block for chapter in chapters for block in chapter.blocks]
    printed = [*result.headline, *result.warnings, *trust.objections(result)]
    return "\n".join([*dict.fromkeys(printed), "", *block_lines(blocks)]) + "\n"


def block_lines(blocks: Sequence[Block]) -> list[str]:
    """Blocks of a report in lines of text, of figures their captions."""
    lines: list[str] = []
    for block in blocks:
        if isinstance(block, Items):
            lines += [f"- {item}" for item in block.items]
        elif isinstance(block, Table):
            lines.append(block.caption)
            lines.append(" | ".join(column.title for column in block.columns))
            lines += [" | ".join(row) for row in block.rows]
        elif isinstance(block, Picture):
            lines.append(block.caption)
        elif isinstance(block, (Paragraph, Notice)):
            lines.append(block.text)
    return lines


# -- truths ----------------------------------------------------------------------------


def _print_truths(options: argparse.Namespace) -> int:
    folder = options.out / "set"
    numbered = json.loads((folder / CHOSEN).read_text(encoding="utf-8"))
    for number, (machine, name) in numbered.items():
        label = cases.labels(folder, machine)[name]
        print(f"| {number} | {machine} | {truth(label)} |")
    return 0


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
