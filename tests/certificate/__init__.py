"""Tests of `pkm_certificate`."""
