"""Tian et al. (2016), Kinematic calibration of a 3-DOF spindle head using a double ball
bar, Mech. Mach. Theory 102, 167-178, and what follows from its equations by two
derivations that share no code (the toolkit's and the oracle's).
"""

A, B, C, D = 0.250, 0.250, 0.526, 0.540  #: Table 1, m
BAR = 0.300
TEACH_Z = C + D + 0.220  #: height of the fixed ball that reproduces Table 2, m

#: Table 2: stroke (m) -> smallest and largest theta over the circle, deg
TABLE_2 = {0.080: (28.41, 32.85), 0.200: (32.18, 38.34)}

#: Table 3: errors found on the prototype, mm and deg; what the table leaves blank is
#: zero
TABLE_3_MM = {
    "dq1": -1.0104, "dq2": -1.4540, "dq3": -0.7043,
    "db1y": -0.8735, "db2x": -0.7453, "db3x": -0.0949,
    "da1y": 1.0215, "da1z": 0.7907,
    "da2x": 0.0833, "da2y": 1.0750, "da2z": 1.5004,
    "da3x": 0.1023, "da3y": 0.9646, "da3z": -0.4216,
    "cup.cup_x": 0.0144, "cup.cup_y": -0.0104, "cup.cup_z": -0.0097,
}  # fmt: skip
TABLE_3_DEG = {"beta1": -0.4485, "beta2": -0.7084, "beta3": -0.5500}

#: kappa of H over its 18 identifiable directions: circles at strokes 80 and 200 mm, n
#: points each, all columns as lengths (D dbeta). Taught cup: Eqs. (11)-(12); free cup:
#: three unknown coordinates instead
KAPPA_TAUGHT = {
    12: 3908, 13: 5210, 14: 4587, 15: 3748, 16: 4530, 18: 4184, 20: 4439, 24: 4420,
}  # fmt: skip
KAPPA_FREE = {12: 19446, 15: 17705, 16: 17033, 24: 16855}

#: sum of the logs of the 18 non-zero eigenvalues of H^T H in the same scaling
LOG_DET_PAPER = -65.58
LOG_DET_BEST = -58.68
LOG_DET_BOUND = -58.20

#: home-referenced 1-sigma after the paper's 2 x 15 readings (free cup; tolerances 1 mm
#: home, 0.3 mm joints, 5 mrad beta, 1 mm cup; 0.5 um noise), averaged over strokes 0,
#: 100, 200 mm, theta 5, 15, 25, 35 deg and 12 psi
HOME_REFERENCED_UM = {"x": 55.44, "y": 55.46, "z": 86.12}
HOME_REFERENCED_ARCSEC = {"axis": 6.7, "spin": 33.38}
