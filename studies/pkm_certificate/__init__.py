"""The certificate of a result's folder: Digital Calibration Certificate and PDF.

certify_folder  writes both; returns what they state, and the paths
sentences       conformity, for a terminal
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_certificate.build import certify_folder, sentences
else:
    # imported when first used: `oed --help` imports the subcommand
    __getattr__ = door(__name__)
