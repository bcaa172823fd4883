"""A study file as written: its text becomes a `Study`, or a refusal with field and remedy.

Study         a study as written, with the place of its file
SUFFIX        end of a study file's name
decode_table  a struct from a table of TOML
tables_of     the tables of a text in TOML
SCHEMAS       descriptions of the files, for `oed schema`
combinations  settings of a sweep, each with each
PublishedFile a file of a collection, and what is wrong with it
Row           a row of a collection, cells by column
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.study.data_sources import PublishedFile, Row
    from pkm_studies.study.decode import decode_table, tables_of
    from pkm_studies.study.loader import SUFFIX, Study, combinations
    from pkm_studies.study.schemas import SCHEMAS
else:
    __getattr__ = door(__name__)
