"""FLSun V400, a linear delta printer: calibration sessions published with their
firmware's own fits (CC0; columns, units and kinematics in SOURCE.txt beside the data).
Lengths in mm.
"""

#: root mean square residual of the firmware's own fit: (heights, distances), by session
FIRMWARE_RMS = {
    "S01": (0.006336, None),
    "S02": (0.004076, None),
    "S03": (0.027987, 0.055189),
    "S04": (0.034187, 0.066353),
}

#: nominal geometry against the distances: least and largest of the sessions
NOMINAL_DISTANCES = (0.25, 0.30)

#: what an ordinary fit of 9 parameters to (fitted, predicted) reaches on the session it
#: did not see: heights (the bed's own height free), distances; and what is asked of the
#: toolkit
ORDINARY = {("S04", "S03"): (0.056, 0.075), ("S03", "S04"): (0.057, 0.084)}
ASKED = {("S04", "S03"): (0.060, 0.080), ("S03", "S04"): (0.060, 0.090)}

#: the same of 6 parameters fitted to heights alone: distances only to
HEIGHTS_ALONE = (0.17, 0.22)
