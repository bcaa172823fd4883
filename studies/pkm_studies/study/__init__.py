"""A study file as written: its tables, and how they are loaded."""

from pkm_studies.study.loader import SUFFIX as SUFFIX
from pkm_studies.study.loader import Study as Study
from pkm_studies.study.loader import load as load
from pkm_studies.study.loader import parse as parse
from pkm_studies.user_code import Consent as Consent
