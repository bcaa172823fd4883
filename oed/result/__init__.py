"""The types of result.json: what studies write and reports read."""

from oed.result.study import *  # noqa: F403
