"""Tests of `pkm_campaign`."""
