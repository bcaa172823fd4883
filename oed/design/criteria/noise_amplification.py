"""The noise amplification index: O1, with m counting measurement poses instead of readings."""

from oed.design.catalogue import NamedCriterion
from oed.design.criteria import o1

criterion = NamedCriterion(
    name="noise_amplification",
    about="O1 with m counting poses",
    source="Chang, Li and Li (2011), Chin. J. Mech. Eng., Eq. (17)",
    index=o1.criterion.index,
    index_of_poses=True,
    index_meaning=(
        "the noise amplification index of Eq. (17) of Chang, Li and Li (2011), the"
        " geometric mean of the singular values over the root of the number of poses;"
        " larger is better"
    ),
    symbol="O",
)
