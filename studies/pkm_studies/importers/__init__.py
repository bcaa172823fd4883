"""Importers: files of other programs in, a study with its readings out, one file each."""
