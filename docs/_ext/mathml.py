"""Formulas as MathML: pages show mathematics without scripts and without a network.

Docutils translates the LaTeX source. A formula that it cannot translate is a warning,
and so an error of `make docs`. The glyphs come from STIX Two Math, which the package
ziamath contains; the site gets those parts of the font that formulas use.
"""

from __future__ import annotations

import re
from html import escape
from importlib.resources import files
from logging import WARNING, getLogger
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from fontTools import subset, ttLib
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)

#: Latin, Greek, punctuation, letterlike, arrows, operators, brackets, alphabets
GLYPHS = (
    (0x20, 0x17F),
    (0x2C6, 0x2DD),
    (0x300, 0x338),
    (0x370, 0x3FF),
    (0x2010, 0x205F),
    (0x20D0, 0x20F0),
    (0x2100, 0x22FF),
    (0x2308, 0x230B),
    (0x27E6, 0x27EF),
    (0x2A00, 0x2AFF),
    (0x1D400, 0x1D7FF),
)


#: a function's name followed by anything but a bracket or a space
UNSPACED = re.compile(
    r"<mo>&ApplyFunction;</mo>"
    r"(?!\s*(?:<mspace|(?:<mrow>\s*)?<mo[^>]*>\s*[(\[]))"
)


def translate(node: nodes.Element, *, as_block: bool) -> str:
    """MathML of a formula; its source as code where it cannot be translated."""
    source = node.astext()
    try:
        text = str(tex2mathml(source, as_block=as_block))
    except MathError as error:
        logger.warning("formula %r: %s", source, error, location=node)
        return f"<code>{escape(source)}</code>"
    return UNSPACED.sub('<mspace width="0.1667em"></mspace>', text)


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    """A formula within a line."""
    self.body.append(translate(node, as_block=False))
    raise nodes.SkipNode


def visit_display(self: HTML5Translator, node: nodes.math_block) -> None:
    """A formula on lines of its own, with its number where it has a label."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    self.body.append(translate(node, as_block=True))
    if node.get("number"):
        number = get_node_equation_number(self, node)
        self.body.append(f'<span class="eqno">({number})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def write_font(app: Sphinx, failure: Exception | None) -> None:
    """Write the parts of the font that formulas use into the site."""
    target = Path(app.outdir, "_static", "math.ttf")
    if failure is not None or app.builder.format != "html" or target.exists():
        return
    getLogger("fontTools").setLevel(WARNING)
    source = files("ziamath").joinpath("fonts", "STIXTwoMath-Regular.ttf")
    font = ttLib.TTFont(str(source))
    options = subset.Options(layout_features=["ssty", "flac", "dtls"], hinting=False)
    subsetter = subset.Subsetter(options)
    subsetter.populate(unicodes=[c for a, b in GLYPHS for c in range(a, b + 1)])
    subsetter.subset(font)
    font.save(target)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer `mathml`, and the font."""
    app.connect("build-finished", write_font)
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
