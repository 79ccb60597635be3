"""Which way up a drawn array is: row 0 on top and column 0 at the left, as a photo viewer shows the file."""

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage


def is_upright(drawn: AxesImage) -> bool:
    """Whether row 0 of an array is on top on the canvas, and column 0 at the left; axes may be turned round, too."""
    left, right, bottom, top = drawn.get_extent()
    # With the origin "upper", row 0 lies at what matplotlib calls the top, wherever the axis puts that.
    first, last = (top, bottom) if drawn.origin == "upper" else (bottom, top)
    (x0, y0), (x1, y1) = drawn.get_transform().transform([(left, first), (right, last)])
    return bool(x0 < x1 and y0 > y1)


def turned(figure: Figure) -> list[str]:
    """Titles of panels whose array is not upright."""
    return [
        axes.get_title() or repr(axes)
        for axes in figure.axes
        for drawn in axes.get_images()
        if drawn.get_array().ndim >= 2 and min(drawn.get_array().shape[:2]) > 1 and not is_upright(drawn)
    ]


@pytest.fixture(autouse=True)
def upright_only(monkeypatch):
    """In every test that knows this fixture, no array is drawn upside down, into whatever file or page."""
    draw = Axes.imshow

    def drawn(axes, *arguments, **options):
        shown = draw(axes, *arguments, **options)
        assert is_upright(shown), "drawn upside down: row 0 of an array belongs on top"
        return shown

    monkeypatch.setattr(Axes, "imshow", drawn)


@pytest.fixture
def any_way_up(upright_only, monkeypatch):
    """Asked for by a test that draws upside down on purpose."""
    monkeypatch.undo()
