"""Parameter names in the order of the parameter vector, frozen: stored results and readings depend on it."""

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
}  # fmt: skip

FRAME = {"a3_head": ("db1x", "db2y", "db3y", "db1z", "db2z", "db3z"), "linear_delta": ("angle3",)}

NUISANCES = {
    "ball_bar": ("cup_x", "cup_y", "cup_z"),
    "ball_bar_free_cup": ("cup_x", "cup_y", "cup_z"),
    "height_probe": ("offset",),
    "calliper": ("scale",),
}
