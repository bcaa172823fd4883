"""Tests of `pkm_printers`."""
