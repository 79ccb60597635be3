"""The page in a real browser, opened as a file, without a network."""

import json

import numpy as np
import pytest
from PIL import Image

from cli.report.write import report_text

# Places of plots, for the screenshot to be cut; written once everything is drawn.
PLACES = """
// By height the plate has colours all over; deviations are nearly white here.
var height = document.querySelector('button.colour[data-map="height"]');
if (height) height.click();
setTimeout(function () {
  var places = {};
  document.querySelectorAll(".plot, svg.frame").forEach(function (plot, index) {
    var box = plot.getBoundingClientRect();
    if (box.width) places[plot.id || "frame-" + index] = [box.left, box.top, box.right, box.bottom].map(Math.round);
  });
  document.documentElement.dataset.places = JSON.stringify(places);
  document.documentElement.dataset.wide = document.documentElement.scrollWidth + " " + window.innerWidth;
}, 1500);
"""


def test_everything_is_drawn(content, browse):
    """No error, nothing refused, every plot full of colours (the surface by WebGL), nothing wider than the window."""
    root, picture = browse(report_text(content), PLACES, size=(1400, 6400), scale=0.5)
    assert root.get("errors") is None
    assert root["ready"] == "true"
    wide, window = map(int, root["wide"].split())
    assert wide <= window == 1400
    shown = Image.open(picture).convert("RGB")
    places = json.loads(root["places"])
    assert {"surface-plot", "map-deviation", "map-height", "map-uncertainty", "map-error"} <= set(places)
    assert {"section-x", "section-y", "histogram-deviation", "convergence-plot"} <= set(places)
    for name, place in places.items():
        left, top, right, bottom = (side // 2 for side in place)
        assert bottom <= shown.height, name
        region = np.asarray(shown.crop((left, top, right, bottom))).astype(float)
        assert region.std(axis=(0, 1)).max() > 8, name
    # The plate, coloured, fills a tenth of its plot at least; axes and background are grey.
    surface = np.asarray(shown.crop([side // 2 for side in places["surface-plot"]])).astype(int)
    assert (np.ptp(surface[:, : surface.shape[1] * 4 // 5], axis=2) > 25).mean() > 0.1


def test_narrow_window(content, browse):
    """As on a phone: browsers make no window under 500 px, so the body is narrower than that."""
    text = report_text(content).replace("<body>", '<body style="width: 360px; margin: 0">')
    root, _ = browse(text, PLACES, size=(500, 900))
    assert root.get("errors") is None
    assert all(right <= 361 for _, _, right, _ in json.loads(root["places"]).values())


POINT = """
var root = document.documentElement, map = document.getElementById("map-height"), slider = document.getElementById("column");
function at(x, y) {
  var pad = map.querySelector(".nsewdrag"), box = pad.getBoundingClientRect();
  pad.dispatchEvent(new MouseEvent("mousemove", {bubbles: true, clientX: box.left + x * box.width, clientY: box.top + y * box.height}));
}
function line(id) { return Array.from(document.getElementById(id).data.find(function (one) { return one.name === "recovered"; }).y); }
// What is expected is waited for, what must not happen is given time to.
function within(count, isReached, then) {
  if (isReached() || count === 0) then(); else setTimeout(function () { within(count - 1, isReached, then); }, 100);
}
function shows(section) { return function () { return root.dataset.section === section; }; }
root.dataset.first = root.dataset.section;
at((11 + 0.5) / 32, (25 + 0.5) / 32);
within(20, shows("25,11"), function () {
  root.dataset.pointed = root.dataset.section;
  root.dataset.along = JSON.stringify([line("section-x"), line("section-y")]);
  map.emit("plotly_click", {points: [{pointIndex: [25, 11]}]});
  at((3 + 0.5) / 32, (4 + 0.5) / 32);
  within(8, shows("4,3"), function () {
    root.dataset.fixed = root.dataset.section;
    slider.value = "30";
    slider.dispatchEvent(new Event("input"));
    within(20, shows("25,30"), function () { root.dataset.slid = root.dataset.section; root.dataset.told = document.getElementById("column-mm").textContent; });
  });
});
"""


def without_webgl(text):
    """The page in a browser that has none."""
    script = """<script>
    HTMLCanvasElement.prototype.getContext = (function (own) {
      return function (kind) { return /webgl/.test(kind) ? null : own.apply(this, arguments); };
    })(HTMLCanvasElement.prototype.getContext);</script>"""
    return text.replace("<body>", f"<body>{script}")


def test_sections_follow_the_pointer(content, browse):
    """First through the highest point; then under the pointer; fixed by a click; moved by a slider."""
    root, _ = browse(without_webgl(report_text(content)), POINT, has_webgl=False)
    assert root.get("errors") is None
    assert (root["first"], root["pointed"], root["fixed"], root["slid"]) == ("20,5", "25,11", "25,11", "25,30")
    along_x, along_y = json.loads(root["along"])
    np.testing.assert_allclose(along_x, content.heights_m[25] * 1e6, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(along_y, content.heights_m[:, 11] * 1e6, rtol=1e-5, atol=1e-3)
    assert root["told"] == f"{((30 + 0.5) / 32 - 0.5) * 50:.2f} mm"


SWITCH = """
setTimeout(function () {
  var root = document.documentElement, plot = document.getElementById("surface-plot"), said = [];
  function note() { said.push([plot.layout.scene.aspectratio.z, plot.data[0].cmin, plot.data[0].colorbar.title.text, plot.data[1].visible, plot.data[0].z[0][0], plot.data[1].z[0][0], plot.data[0].z[20][5], plot.data[1].z[20][5]]); }
  note();
  document.getElementById("true-scale").click();
  document.querySelector('button.colour[data-map="height"]').click();
  setTimeout(function () { note(); root.dataset.said = JSON.stringify(said); }, 500);
}, 500);
"""


def test_surface_switches_scale_and_colour(content, browse):
    root, _ = browse(report_text(content), SWITCH)
    assert root.get("errors") is None
    (tall, low, label, *judged), (flat, lowest, other, is_grey, *_) = json.loads(root["said"])
    relief_mm = np.ptp(content.heights_m) * 1e3
    assert flat == pytest.approx(1.04 * relief_mm / 50, rel=1e-4)
    assert tall >= 5 * flat and tall <= 0.25
    assert (label, other) == ("measured - design [um]", "height [um]")
    assert lowest == pytest.approx(content.heights_m.min() * 1e6, rel=1e-4)
    # What is not judged is in the grey surface, all else in the coloured one; the height is known everywhere.
    corner, peak = content.heights_m[0, 0] * 1e6, 500
    assert judged == [True, None, pytest.approx(corner, rel=1e-4), pytest.approx(peak, rel=1e-4), None]
    assert low <= -60 and is_grey is False


def test_bare_result_without_webgl(bare, browse):
    """A picture stands in for the surface."""
    told = """setTimeout(function () {
      var lit = document.querySelector(".static.lit");
      document.documentElement.dataset.lit = getComputedStyle(lit).display;
    }, 500);"""
    root, _ = browse(without_webgl(report_text(bare)), told, has_webgl=False)
    assert root.get("errors") is None and root["ready"] == "true"
    assert root["lit"] == "block"


def test_without_javascript(content, browse):
    """Still pictures with axes, and a word on what is missing."""
    text = report_text(content).replace("script-src 'unsafe-inline' 'unsafe-eval'", "script-src 'none'")
    root, picture = browse(text, size=(800, 1800), has_webgl=False)
    assert root == {}
    shown = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    # The map of deviations: blue of the scale's end, or grey where nothing is judged.
    assert (np.abs(shown - (190, 190, 190)).max(axis=2) < 3).mean() > 0.005
    assert shown.std() > 20
