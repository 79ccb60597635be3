"""Pictures of commands in a sixth of the time, where a test looks at something else.

Every panel, line and text of a figure is still drawn, once; what is left out is the search for a layout in which no
text touches another, which draws everything thrice more, and most pixels. A test that asks for ``full_figures`` gets
them as they are.
"""

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DPI = 20
_savefig = Figure.savefig


def quickly(figure, target, **options):
    figure.set_layout_engine("none")
    figure.set_dpi(DPI)
    if options.get("format") == "png" or str(target).endswith(".png"):
        FigureCanvasAgg(figure).print_png(target)
    else:
        _savefig(figure, target, **options)


@pytest.fixture(autouse=True)
def quick_figures(request, monkeypatch):
    if "full_figures" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", quickly)


@pytest.fixture
def full_figures():
    """Asked for by tests of how figures look."""
