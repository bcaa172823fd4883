"""Parameter names in the order of the parameter vector, frozen: stored results and
readings depend on it.
"""

NAMES = {
    "a3_head": (
        "dq1", "dq2", "dq3",
        "db1x", "db1y", "db1z", "db2x", "db2y", "db2z", "db3x", "db3y", "db3z",
        "da1x", "da1y", "da1z", "da2x", "da2y", "da2z", "da3x", "da3y", "da3z",
        "beta1", "beta2", "beta3",
    ),
    "linear_delta": (
        "radius", "arm1", "arm2", "arm3", "angle1", "angle2", "angle3", "endstop1", "endstop2", "endstop3",
    ),
    "micro_cmm": (
        "rf1", "rf2", "rf3", "rp1", "rp2", "rp3", "thetaf1", "thetaf2", "thetaf3", "thetap1", "thetap2", "thetap3",
        "dl1", "dl2", "dl3",
    ),
    "hexapod": (
        "db1x", "db1y", "db1z", "db2x", "db2y", "db2z", "db3x", "db3y", "db3z",
        "db4x", "db4y", "db4z", "db5x", "db5y", "db5z", "db6x", "db6y", "db6z",
        "da1x", "da1y", "da1z", "da2x", "da2y", "da2z", "da3x", "da3y", "da3z",
        "da4x", "da4y", "da4z", "da5x", "da5y", "da5z", "da6x", "da6y", "da6z",
        "dl1", "dl2", "dl3", "dl4", "dl5", "dl6",
    ),
    "hexaglide": (
        "dq1", "dq2", "dq3", "dq4", "dq5", "dq6",
        "db1y", "db1z", "db2y", "db2z", "db3y", "db3z", "db4y", "db4z", "db5y", "db5z", "db6y", "db6z",
        "da1x", "da1y", "da1z", "da2x", "da2y", "da2z", "da3x", "da3y", "da3z",
        "da4x", "da4y", "da4z", "da5x", "da5y", "da5z", "da6x", "da6y", "da6z",
        "dl1", "dl2", "dl3", "dl4", "dl5", "dl6",
    ),
    "cable_robot": (
        "anchor1x", "anchor1y", "anchor1z", "anchor2x", "anchor2y", "anchor2z",
        "anchor3x", "anchor3y", "anchor3z", "anchor4x", "anchor4y", "anchor4z",
        "radius1", "radius2", "radius3", "radius4", "line1", "line2", "line3", "line4",
    ),
    "planar_2dof": ("D", "z1", "z2", "l1", "l2", "beta1", "beta2"),
    "prs_spindle": (
        "db1x", "db1y", "db1z", "dR1x", "dR1y", "dl1",
        "db2x", "db2y", "db2z", "dR2x", "dR2y", "dl2",
        "db3x", "db3y", "db3z", "dR3x", "dR3y", "dl3",
    ),
    "prs_spindle_struts": (
        "db1x", "db1y", "db1z", "dR1x", "dR1y", "dl1",
        "db2x", "db2y", "db2z", "dR2x", "dR2y", "dl2",
        "db3x", "db3y", "db3z", "dR3x", "dR3y", "dl3",
    ),
}  # fmt: skip

FRAME = {
    "a3_head": ("db1x", "db2y", "db3y", "db1z", "db2z", "db3z"),
    "linear_delta": ("angle3",), "micro_cmm": (), "hexapod": (), "hexaglide": (),
    "cable_robot": (), "planar_2dof": (), "prs_spindle": (), "prs_spindle_struts": (),
}  # fmt: skip

REGISTRATION = ("shift_x", "shift_y", "shift_z", "turn_x", "turn_y", "turn_z")

NUISANCES = {
    "ball_bar": ("cup_x", "cup_y", "cup_z"),
    "ball_bar_free_cup": ("cup_x", "cup_y", "cup_z"),
    "height_probe": ("offset",),
    "contact_probe": ("offset",),
    "length_gauge": ("height", "tilt_x", "tilt_y"),
    "calliper": ("scale",),
    "passive_joint": ("zero_swing1", "scale_swing1", "zero_swing2", "scale_swing2"),
    "locked_joint": ("rest_swing2",),
    "seat": ("seat_x", "seat_y", "seat_z"),
    "touch_plane": ("offset", "tilt_u", "tilt_v"),
    "home_orientation": ("zero_x", "zero_y", "zero_z"),
    "level": ("zero_x", "zero_y"), "autocollimator": ("zero_x", "zero_y"),
    "camera": REGISTRATION, "camera_known_frame": (), "ball_plate": REGISTRATION,
    "ball_distance": ("scale",), "redundancy": (), "rm1": (), "rm2": (),
    "rm3": ("tilt",), "rm4": ("tilt",), "rm5": ("tilt",),
    "laser_ball_bar": REGISTRATION, "laser_ball_bar_position": REGISTRATION,
    "pose_tracker": REGISTRATION, "pose_tracker_position": REGISTRATION,
}  # fmt: skip
