"""Errors with file, field, value and remedy; whole files; the console; consent to code."""
