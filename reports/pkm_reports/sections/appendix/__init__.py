"""The appendix: claims, key figures, and the record of what was computed with what."""
