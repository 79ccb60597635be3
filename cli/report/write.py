"""Writes the page of a result."""

from typing import TYPE_CHECKING

from warp_caustics.io.atomic import PathLike

if TYPE_CHECKING:
    from cli.report.content import ReportContent


def write_report(path: PathLike, content: "ReportContent") -> None:
    """Write one self-contained HTML page, complete or not at all.

    Args:
        path: of the page.
        content: what it shows.
    """
    raise NotImplementedError
