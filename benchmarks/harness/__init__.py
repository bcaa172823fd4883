"""One way for all worlds: cases are drawn, diagnosed, judged and tabulated.

A world is a module `benchmarks.NAME.world` with the function `draw`, see `worlds`. The
campaign NAME runs its cases and goes on where it was interrupted:

    PYTHONPATH=. oed campaign --allow-code benchmarks/NAME.campaign.toml
    python -m benchmarks.harness NAME

The second command prints the table. All benchmarks share `tables`, `noise`, `processes` and
`statistics`.
"""
