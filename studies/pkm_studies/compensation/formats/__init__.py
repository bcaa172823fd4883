"""Formats of controllers, one file each."""
