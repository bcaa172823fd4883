"""Study files, the pipeline that runs them, and the `oed` command."""
