"""The certificate of a result's folder: Digital Calibration Certificate and PDF.

certify_folder  writes both; returns what they state, and the paths
sentences       conformity, for a terminal
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oed.base.lazy import attributes

if TYPE_CHECKING:
    from pkm_certificate.certify import certify_folder, sentences

__all__ = ["certify_folder", "sentences"]

# imported when first used: `oed --help` imports the subcommand
__getattr__ = attributes(__name__, {"certify": ("certify_folder", "sentences")})
