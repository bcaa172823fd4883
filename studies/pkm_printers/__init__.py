"""Firmware of printers: logs and configurations in, files for controllers out.

Nothing is imported from here: importers, formats and collections of readings are entry
points `pkm_oed.importers`, `pkm_oed.formats` and `pkm_oed.sources`.
"""
