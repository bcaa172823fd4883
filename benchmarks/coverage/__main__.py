"""Tables of the campaigns on virtual machines that the toolkit did not simulate.

    PYTHONPATH=. oed campaign --allow-code benchmarks/coverage.campaign.toml
    python -m benchmarks.coverage intervals --page docs/benchmarks/coverage.md
    PYTHONPATH=. oed campaign --allow-code benchmarks/ranks.campaign.toml
    python -m benchmarks.coverage ranks --page docs/benchmarks/coverage.md

Each prints the table of a campaign's cases, or writes it into a page.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from benchmarks.coverage import case, cell, ranks, table

#: folder of each campaign's cases, and the block of the page
FOLDER = {"intervals": Path("out/coverage"), "ranks": Path("out/ranks")}
BLOCK = {"intervals": "coverage table", "ranks": "rank table"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print or write the table."""
    options = _parser().parse_args(arguments)
    folder = options.out or FOLDER[options.kind]
    cases = pd.read_parquet(folder / "cases.parquet")
    fitted = cases[cases["error"] == ""]
    text = (intervals if options.kind == "intervals" else rank_table)(fitted)
    if options.page is None:
        print(text)
    else:
        table.write_block(options.page, BLOCK[options.kind], text)


def intervals(cases: pd.DataFrame) -> str:
    """One row a configuration and law."""
    figures = {}
    for key, machines in cases.groupby(["configuration", "law"], sort=False):
        name, law = key
        figures[str(name), str(law)] = cell.summarise(machines.to_dict("records"))
    return table.markdown(figures)


def rank_table(cases: pd.DataFrame) -> str:
    """One row a configuration."""
    results = {}
    for name, machines in cases.groupby("configuration", sort=False):
        setting = dict(machines.iloc[0][["configuration", "sampler", "stream"]])
        results[str(name)] = case.calibration(machines, setting)
    return ranks.markdown(results)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage")
    parser.add_argument("kind", choices=[*FOLDER], help="which table")
    parser.add_argument("--out", type=Path, help="folder of the campaign's cases")
    parser.add_argument("--page", type=Path, help="page to write the table into")
    return parser


if __name__ == "__main__":
    main()
