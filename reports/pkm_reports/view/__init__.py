"""What the page's views show: machine, readings, error map and gap as points.

build_view             the view of a result; None where it has nothing to show
PageView               its lines, readings, fields and circles
ViewLine               a polyline, mm
ViewLabel              names of parameters at a point, mm
ViewReading            a reading with its place, values and run
encoded_view           a view as JSON within a page's script
residuals_of_readings  the residuals of a result by reading
points_mm              points that are given in m, in mm
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_reports.view.scene import (
        PageView,
        ViewLabel,
        ViewLine,
        ViewReading,
        build_view,
        encoded_view,
        points_mm,
        residuals_of_readings,
    )
else:
    __getattr__ = door(__name__)
