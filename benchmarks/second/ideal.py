"""How well can any detector do on the second generator, the noise law unknown?

    python -m benchmarks.second.ideal run --seed 511733 --cases 32 --out out/ideal.jsonl
    python -m benchmarks.second.ideal table out/ideal.jsonl

The first command draws the cases of four machines again, as `python -m benchmarks.second
generate` does with the same seed and number, and computes the log Bayes factors of the
observers of `observers.py` on fresh noise with and without the effect of each case. The
second prints the share detected where one in 20 healthy sets of readings is called a gap.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from benchmarks.exit_code import exit_code
from benchmarks.second import noise_laws, observers, recorded
from benchmarks.second.replay import Generator, Replay
from benchmarks.second.score import SIX, TEN
from oed.gap.cause.hypothesis import PRIOR
from oed.result import GapSection

#: realizations of noise without the effect of a case, and with it
HEALTHY, WITH_EFFECT = 60, 40
#: sqrt(lambda) that an observer holds possible, equally likely
SIZES = np.array([2.0, 4.0, 6.0, 10.0, 20.0])
#: shares of false alarms
ALARMS = (0.05, 0.01)
#: prior probability of a gap that shows, as the toolkit has it
GAP = 1.0 - PRIOR["none"] - PRIOR["unseen"]
KINDS = ("single", "pair", "unknown")
#: what is added to an observer's name where it knows no more of the laws than the toolkit
USUAL = ", usual laws"
#: shapes of noise for which it can be judged: its laws have no tails
GAUSSIAN = ("white", "repeat", "ar1", "mix")


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 2 bad input."""
    return exit_code(recorded.parser("ideal", __doc__, _run, _table), arguments)


def _run(options: argparse.Namespace) -> int:
    return recorded.record_cases(options, KINDS, _row)


def _row(
    generator: Generator, replay: Replay, machine: str, rng: np.random.Generator
) -> dict[str, Any]:
    """Log Bayes factors of each observer: healthy, with the effect, of the case itself."""
    label = replay.label
    law = noise_laws.law_of_label(label["law"])
    healthy_laws = [noise_laws.draw_law(rng) for _ in range(HEALTHY)]
    healthy = [noise_laws.draw_noise(replay, drawn, 1, rng) for drawn in healthy_laws]
    noise = noise_laws.draw_noise(replay, law, WITH_EFFECT, rng)
    itself = (replay.readings - replay.case.y) / replay.sigma
    itself += replay.slopes @ rng.standard_normal(replay.slopes.shape[1])
    data = np.hstack([*healthy, noise + replay.change[:, None], itself[:, None]])
    drawn = observers.draw_effects(generator, replay, machine, rng)
    names = [e["effect"] for e in label["effects"]]
    factors = {}
    for words, grid in ("", noise_laws.laws()), (USUAL, noise_laws.usual_laws()):
        of_grid = observers.log_factors(replay, data, drawn, names, SIZES, grid)
        factors |= {f"{name}{words}": values for name, values in of_grid.items()}
    row: dict[str, Any] = {
        "kind": label["kind"],
        "law": label["law"]["law"],
        "total": label["sqrt_lambda_total"],
        "effects": names,
        "out_of_span": min(e["out_of_span"] for e in label["effects"]),
        "healthy_is_gaussian": [drawn.shape == "white" for drawn in healthy_laws],
    }
    for observer, by_size in factors.items():
        log_factor = special.logsumexp(by_size, axis=0) - np.log(len(SIZES))
        row[observer] = {
            "healthy": np.round(log_factor[:HEALTHY], 3).tolist(),
            "gap": np.round(log_factor[HEALTHY:-1], 3).tolist(),
            "itself": round(float(log_factor[-1]), 3),
        }
    return row


def _table(options: argparse.Namespace) -> int:
    return recorded.print_table(options, table)


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Share detected by each observer: at shares of false alarms, and by its posterior."""
    columns = [*(f"{100 * a:.0f} % false alarms" for a in ALARMS), "posterior rule"]
    lines = [
        "| observer | gaps | n | " + " | ".join(columns) + " |",
        "|---" * (3 + len(columns)) + "|",
    ]
    for observer in (observers.EXACT, observers.NAMED, observers.ANY):
        lines += _lines(observer, observer, rows)
    gaussian = [_gaussian(r) for r in rows if r["law"] in GAUSSIAN]
    for observer in (observers.ANY, observers.ANY + USUAL):
        lines += _lines(f"{observer}, Gaussian noise", observer, gaussian)
    return lines


def _gaussian(row: Mapping[str, Any]) -> dict[str, Any]:
    """A case without its healthy noises that are not Gaussian."""
    kept = np.array(row["healthy_is_gaussian"])
    parts = {n: v for n, v in row.items() if isinstance(v, Mapping)}
    healthy = {
        name: {**part, "healthy": np.array(part["healthy"])[kept].tolist()}
        for name, part in parts.items()
    }
    return {**row, **healthy}


def _lines(words: str, observer: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of an observer, for the cases in which it was one."""
    with_it = [r for r in rows if observer in r]
    if not with_it:
        return []
    healthy = np.concatenate([r[observer]["healthy"] for r in with_it])
    limits = [float(np.quantile(healthy, 1.0 - a)) for a in ALARMS]
    limits.append(_limit_of_rule())
    alarms = [float(np.mean(healthy > limit)) for limit in limits]
    lines = [_line(words, "none: false alarms", len(healthy), alarms)]
    for part_words, part in _parts(with_it):
        shares = [_share(part, observer, limit) for limit in limits]
        lines.append(_line(words, part_words, len(part), shares))
    return lines


def _limit_of_rule() -> float:
    """Log Bayes factor from which P(no gap) is below GapSection.NO_GAP_PROBABILITY."""
    return float(
        special.logit(1.0 - GapSection.NO_GAP_PROBABILITY) - special.logit(GAP)
    )


def _parts(
    rows: Sequence[Mapping[str, Any]],
) -> list[tuple[str, Sequence[Mapping[str, Any]]]]:
    """Cases by size and kind, with words for them."""
    parts = []
    for words, low, high in (("6", SIX, TEN), ("10 and more", TEN, np.inf)):
        among = [r for r in rows if low <= r["total"] < high]
        parts.append((words, among))
        for kind, name in (("single", "single"), ("unknown", "never listed")):
            parts.append((f"{words}, {name}", [r for r in among if r["kind"] == kind]))
    return [(words, part) for words, part in parts if part]


def _share(rows: Sequence[Mapping[str, Any]], observer: str, limit: float) -> float:
    """Mean over cases of the share of noise realizations with the gap detected."""
    return float(np.mean([np.mean(np.array(r[observer]["gap"]) > limit) for r in rows]))


def _line(observer: str, words: str, count: int, values: Sequence[float]) -> str:
    cells = " | ".join(f"{v:.2f}" for v in values)
    return f"| {observer} | {words} | {count} | {cells} |"


if __name__ == "__main__":
    sys.exit(main())
