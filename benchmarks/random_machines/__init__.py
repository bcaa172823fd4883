"""The diagnosis on random machines without a gap: how often it reports one."""
