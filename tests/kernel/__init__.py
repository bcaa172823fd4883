"""Tests of `oed`, and the cases they share."""
