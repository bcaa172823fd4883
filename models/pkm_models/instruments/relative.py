"""Relative measurements RM 1 to 5: how far the tool is off a line, against one
reference reading on that line.

Chang, Li and Li (2011), sections 2.3.1-2.3.2 and 2.4, Eq. (13): read is X_i - X_0, with
X_0 the run's reference.

    rm1   along y, dy by laser interferometer        rm2   along z, dz by laser interferometer
    rm3   along y, dz by micrometer on a ruler       rm4   along z, dy by micrometer on a square
    rm5   rm1 and rm3 at once

One run is one line; its first pose is the reference configuration, which reads 0 by
definition. All readings of a line are differences from the one reference reading, whose own
noise they share: Channel.shared = 1.

An interferometer reads along its beam, so that a beam out of line costs a cosine only.
A micrometer reads across the line: a ruler or square out of line by `tilt` adds tilt
times the distance travelled. The paper takes its reference planes as perfect, and so
does this module: the tolerance of `tilt` is 0, that is, held. With `tolerance = {
tilt_mrad = ... }` a set-up frees it; it cannot be distinguished from a common tilt of both
guides then.

Noise, one standard deviation: the paper states none. Laser interferometer 1 um (0.5
um/m of air and alignment over the 3 m line, and resolution), micrometer 3 um (a dial
gauge of 1 um division on a ground ruler).
"""

from collections.abc import Callable, Mapping, Sequence

from oed.instrument import Channel, Cost, Frame, Instrument
from oed.model import Expr, Parameter, Values

SOURCE = "Chang, Li and Li 2011, Chin. J. Mech. Eng., sections 2.3.2 and 2.4"
LASER_SIGMA = 1.0e-6  #: noise of a laser interferometer, m
MICROMETER_SIGMA = 3.0e-6  #: noise of a micrometer, m
TILT = Parameter(
    "tilt",
    0.0,
    0.0,
    "rad",
    "angle of ruler or square to the line it stands for; held unless freed",
)
LINES = "xyz"


def _read(axis: int, line: int) -> Callable[..., Expr]:
    """Displacement along the line, or deviation along another axis from a ruler along
    it, up to its tilt.
    """

    def read(frames: Sequence[Frame], s: Values, k: Values) -> Expr:
        moved = frames[0].point - frames[1].point
        if axis == line:
            return moved[axis]
        return moved[axis] - s["tilt"] * moved[line]

    return read


def _relative(
    name: str, about: str, along: str, sigmas: Mapping[str, float], cost: Cost
) -> Instrument:
    """Readings along a line, `dy` and `dz` each with its noise, m."""
    line = LINES.index(along)
    axes = [LINES.index(channel.removeprefix("d")) for channel in sigmas]
    reads = [_read(axis, line) for axis in axes]
    return Instrument(
        name=name,
        source=SOURCE,
        about=about,
        channels=tuple(_channel(channel, sd) for channel, sd in sigmas.items()),
        settings=(),
        nuisances=() if axes == [line] else (TILT,),
        cost=cost,
        observe=lambda frames, s, k: [read(frames, s, k) for read in reads],
        reference="run",
    )


def _channel(name: str, sigma: float) -> Channel:
    axis = name.removeprefix("d")
    about = f"{axis} of the tool point less that of the run's first pose, base frame"
    return Channel(name, "m", sigma, shared=1.0, about=about)


_LASER, _MICROMETER = Cost(setup=3600.0, reading=30.0), Cost(setup=1200.0, reading=20.0)
_BOTH = {"dy": LASER_SIGMA, "dz": MICROMETER_SIGMA}

rm1 = _relative(
    "rm1", "RM 1: dy along y, laser interferometer", "y", {"dy": LASER_SIGMA}, _LASER
)
rm2 = _relative(
    "rm2", "RM 2: dz along z, laser interferometer", "z", {"dz": LASER_SIGMA}, _LASER
)
rm3 = _relative(
    "rm3", "RM 3: dz along y, micrometer", "y", {"dz": MICROMETER_SIGMA}, _MICROMETER
)
rm4 = _relative(
    "rm4", "RM 4: dy along z, micrometer", "z", {"dy": MICROMETER_SIGMA}, _MICROMETER
)
rm5 = _relative(
    "rm5",
    "RM 5: dy and dz along y, laser interferometer and micrometer",
    "y",
    _BOTH,
    Cost(setup=4800.0, reading=40.0),
)
