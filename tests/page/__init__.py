"""Tests of `pkm_page`."""
