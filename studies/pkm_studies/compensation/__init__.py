"""Files for controllers: what a result sends to the machine, and what that costs.

export_folder          writes a result's folder in a format
export_result          the same, from a result in memory
named_format           the format that a name, or a file of the user, stands for
identified_parameters  the parameters that a controller gets, and what they rest on
adjusted_result        a result as it is after a fitter's adjustments
result_study           the study of a stored result, and its machine
TableAccuracy          how accurate a table of commands must be
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.compensation.export import (
        export_folder,
        export_result,
        named_format,
    )
    from pkm_studies.compensation.identified import (
        adjusted_result,
        identified_parameters,
        result_study,
    )
    from pkm_studies.compensation.table_grid import TableAccuracy
else:
    __getattr__ = door(__name__)
