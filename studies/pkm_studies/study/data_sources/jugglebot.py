"""108 static poses of a six-legged platform (Jugglebot, MIT), read by motion capture.

`poses_108.csv` has the motors' revolutions and the platform's pose with a quaternion.
Leg lengths are those at 0 revolutions, of the design at its lowest height, and the
published revolutions per metre. Every second pose becomes the set-up `fit`, the others
`blind`. Angles are of R = Rx(alpha) Ry(beta) Rz(gamma).
"""

from collections.abc import Iterator
from pathlib import Path

from oed.text import shorten
from pkm_studies.study.data_sources import PublishedFile, Row

REVOLUTIONS = tuple(f"leg_length_{k}" for k in range(1, 7))
POSITION = tuple(f"position_{axis}" for axis in "xyz")
QUATERNION = tuple(f"orientation_{axis}" for axis in "xyzw")
#: mm, between the joints of a leg, at 0 revolutions: the platform 565 mm above the base
LEG_LENGTH_MM = 640.1966443
#: revolutions per metre of each leg, from a bench
PER_METRE = (13.21144, 14.0456, 13.8233, 14.124109, 14.16007, 14.03256)


def rows(folder: Path) -> Iterator[Row]:
    """Rows of a readings file. Raises InputError."""
    file = PublishedFile(folder / "poses_108.csv")
    poses = file.csv_rows((*REVOLUTIONS, *POSITION, *QUATERNION))
    for i, pose in enumerate(poses):
        label = {"setup": "blind" if i % 2 else "fit", "run": "1"}
        try:
            yield label | {"order": str(i // 2 + 1)} | _legs(pose) | _read(pose)
        except ValueError as error:
            raise file.error(shorten(str(error), 80), f"row {i + 1}") from None


def _legs(pose: Row) -> Row:
    turns = zip(REVOLUTIONS, PER_METRE, strict=True)
    lengths = [LEG_LENGTH_MM + 1e3 * float(pose[name]) / scale for name, scale in turns]
    return {f"q{k + 1}_mm": repr(length) for k, length in enumerate(lengths)}


def _read(pose: Row) -> Row:
    position = {f"read_{name[-1]}_mm": pose[name] for name in POSITION}
    from scipy.spatial.transform import Rotation  # only this collection needs it

    quaternion = [float(pose[name]) for name in QUATERNION]
    angles = Rotation.from_quat(quaternion).as_euler("XYZ", degrees=True).tolist()
    pairs = zip(("alpha", "beta", "gamma"), angles, strict=True)
    return position | {f"read_{name}_deg": repr(angle) for name, angle in pairs}
