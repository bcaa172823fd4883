"""Printed answers of random cases, to be read by somebody who does not know the truth.

    python -m benchmarks.second.texts answers --seed 7
    python -m benchmarks.second.texts truths

The first command draws 25 cases of each machine, takes five of each at random, and
diagnoses them as `oed diagnose` does. `NN.txt` has what the command prints of it, and the
words of the report's chapters on the gap. The second one prints what acts in each case.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import oed
from benchmarks.harness.worlds import Case
from benchmarks.second import world
from oed import trust
from oed.result import StudyResult
from pkm_reports import sections
from pkm_reports.blocks import Block, Items, Notice, Paragraph, Picture, Table
from pkm_studies import stages

OUT = Path("out/second/texts")
#: cases of each machine in the set, and those of them that are read
DRAWN, READ = 25, 5
#: chapters of a report on the gap
GAP_CHAPTERS = ("gap", "second_visit")
#: kinds of noise laws by the label's name of their size, in units of the stated noise
LAW_SIZES = ("repeat_over_sigma", "ar_over_sigma")


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 no generator."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.second.texts", description=__doc__
    )
    parser.add_argument("command", choices=("answers", "truths"))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    try:
        world.generate(OUT / "set", options.seed, DRAWN)
    except FileNotFoundError as missing:
        print(f"the second generator is not there ({missing})", file=sys.stderr)
        return 2
    for number, (machine, case) in enumerate(chosen(options.seed), 1):
        if options.command == "answers":
            _write_answer(OUT / f"{number:02d}.txt", machine, case)
        else:
            with tempfile.TemporaryDirectory() as folder:
                label = _drawn(machine, case, Path(folder)).label
            print(f"| {number:02d} | {machine} | {truth(label)} |")
    return 0


def chosen(seed: int) -> list[tuple[str, int]]:
    """Machine and number of some cases of each machine, in random order."""
    rng = np.random.default_rng(seed)
    drawn = [
        (machine, int(number))
        for machine in world.MACHINES
        for number in rng.choice(DRAWN, READ, replace=False)
    ]
    return [drawn[k] for k in rng.permutation(len(drawn))]


def _drawn(machine: str, number: int, folder: Path) -> Case:
    setting = {"folder": OUT / "set", "machine": machine}
    return world.draw(setting, number, folder)


# -- answers ---------------------------------------------------------------------------


def _write_answer(path: Path, machine: str, number: int) -> None:
    """Write the answer of a case that has none yet."""
    if path.is_file():
        return
    with tempfile.TemporaryDirectory() as folder:
        case = _drawn(machine, number, Path(folder))
        path.write_text(answer(diagnosis(case)), encoding="utf-8")


def diagnosis(case: Case) -> StudyResult:
    """The result of `oed diagnose` of a case, without the accuracy of a correction."""
    study = oed.load_study(case.study, allow_code=True)
    fitted = stages.fit_checked(stages.recorded(study, [case.readings]))
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
