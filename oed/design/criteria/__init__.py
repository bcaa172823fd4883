"""Criteria, one a file: each module holds one `criterion` (`oed.design.catalogue`)."""
