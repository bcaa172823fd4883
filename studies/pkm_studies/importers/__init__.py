"""Importers: files of other programs in, a study with its readings out, one file each.

import_files     reads files with an importer, and writes study and readings
importers        every importer by its name
ImportRequest    what `oed import` was asked for
ImportedSession  a session as read: study, rows, statements
Row              a row of the readings file, cells by column
MeshUse          what the heights of bed meshes are for
Model            a machine with its table in the study
imported_study   the text of the study of set-ups with their readings
readings_name    name of the readings file that goes with a study
line_field       a line of a file as an error shows it
read_tables      tables of files, each with the oldest line first
Stamp            a time, s, with its date or without one
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.importers.base import (
        ImportedSession,
        ImportRequest,
        MeshUse,
        Row,
        line_field,
        readings_name,
    )
    from pkm_studies.importers.column_map import Model, imported_study
    from pkm_studies.importers.line_times import Stamp, read_tables
    from pkm_studies.importers.session import import_files, importers
else:
    __getattr__ = door(__name__)
