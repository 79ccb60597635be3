"""Warns of pages that need a network: scripts, styles, fonts and pictures of a server."""

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)

LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video|audio)\b[^>]*\bsrc=["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|<link\b(?=[^>]*\brel=["']?(?:stylesheet|preload|icon|preconnect))[^>]*\bhref=["']?((?:https?:)?//[^"'\s>]+)"""
)
IMPORTED = re.compile(r"""(?:@import\s+["']?|url\(\s*["']?)((?:https?:)?//[^"')\s]+)""")


def loaded_from_elsewhere(page: str, is_style: bool = False) -> list[str]:
    """Addresses that a page or a style sheet loads; links that a reader may follow are none."""
    found = IMPORTED.findall(page) if is_style else [a or b for a, b in LOADED.findall(page)] + IMPORTED.findall(page)
    return sorted(set(found))


def _check(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        for path in sorted(Path(app.outdir).rglob("*")):
            if path.suffix in (".html", ".css"):
                for address in loaded_from_elsewhere(path.read_text(encoding="utf-8"), path.suffix == ".css"):
                    logger.warning("%s needs a network: %s", path.name, address)


def setup(app: Sphinx) -> dict[str, bool]:
    """Looks at what was written."""
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
