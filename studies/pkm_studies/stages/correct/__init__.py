"""The stage that corrects: effects with the geometry, and over all hypotheses."""
