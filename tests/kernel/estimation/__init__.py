"""Tests of estimates and sessions."""
