"""Stored results: read, compared, and held against the study's claims."""
