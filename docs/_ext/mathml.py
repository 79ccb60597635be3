"""Formulas as MathML, which browsers draw themselves: no script, no server.

Subscripts and roots sit right only with an OpenType font for mathematics, which
many Linux machines lack. So STIX Two Math (SIL Open Font License), which comes
with ziamath, is copied to the pages, cut down to the signs that formulas use.
"""

import logging as python_logging
import re
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from docutils import nodes
from fontTools import subset
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)

FONT_FILE = "stix-two-math.woff"
# Latin, Greek, punctuation, arrows, operators, angle brackets, letters of formulas.
SIGNS = ((0x20, 0x17F), (0x370, 0x3FF), (0x2000, 0x22FF), (0x27E6, 0x27EB), (0x1D400, 0x1D7FF))


def to_mathml(latex: str, display: str, where: Any = None) -> str:
    """One formula as a ``<math>`` element.

    Args:
        latex: without delimiters.
        display: ``inline`` or ``block``.
        where: node that is named when a command is not understood.
    """
    mathml = convert(latex, display=display)
    unknown = unknown_in(mathml)
    if unknown:
        logger.warning("formula with parts that do not become MathML: %s", ", ".join(unknown), location=where)
    return mathml


def unknown_in(mathml: str) -> list[str]:
    """Commands and alignment marks that the converter did not know: it passes them on."""
    return sorted(set(re.findall(r"\\[A-Za-z]+|&(?![#\w])", re.sub(r"<[^>]*>", " ", mathml))))


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(to_mathml(node.astext(), "inline", node))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(translator.starttag(node, "div", CLASS="formula"))
    translator.body.append(to_mathml(node.astext(), "block", node))
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def write_font(target: Path) -> None:
    """The font of formulas, as WOFF."""
    # It reports every table that it leaves out.
    python_logging.getLogger("fontTools").setLevel(python_logging.WARNING)
    options = subset.Options(flavor="woff", layout_features=["*"])
    with as_file(files("ziamath") / "fonts" / "STIXTwoMath-Regular.ttf") as source:
        font = subset.load_font(str(source), options)
    cutter = subset.Subsetter(options)
    cutter.populate(unicodes=[code for first, last in SIGNS for code in range(first, last + 1)])
    cutter.subset(font)
    subset.save_font(font, str(target), options)


def _copy_font(app: Sphinx, error: Exception | None) -> None:
    target = Path(app.outdir) / "_static" / FONT_FILE
    if error is None and not target.exists():
        write_font(target)


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the renderer ``mathml``."""
    app.connect("build-finished", _copy_font)
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
