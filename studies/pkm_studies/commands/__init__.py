"""The command `oed`."""
