"""The page says what the record says, escapes what people gave, and copes with what is missing."""

import base64
import dataclasses
import html.parser
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from cli.report.arrays import MAP_SAMPLES
from cli.report.write import report_text, write_report
from warp_caustics.scene import Scene

VOID = ("meta", "img", "br", "input")


class Page(html.parser.HTMLParser):
    """Checks nesting; collects tags, links, texts outside scripts and the data of the script."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.links, self.ids, self.words, self.data = [], [], [], [], [], ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.links += [value for name, value in attrs if name in ("src", "href", "action", "data", "poster", "srcset")]
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            if self.tags[-1] == ("script", {"type": "application/json", "id": "data"}):
                self.data += data
        elif self.open and self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())

    @property
    def record(self):
        return json.loads(self.data)


def picture(uri):
    return Image.open(io.BytesIO(base64.b64decode(uri.split(",", 1)[1])))


def unpacked(packed):
    return np.frombuffer(base64.b64decode(packed["f4"]), "<f4").reshape(packed["shape"])


def test_figures_are_those_of_the_record(content):
    page = Page(report_text(content))
    text = page.text
    for said in (
        "\u2715 Fail", "1 region is out of tolerance", "2 warnings", "only a fake", "the design was moved", "\u00b120 um",
        "Image residual 1.23 %", "RMSE to reference 4.57 um", "95 % within 9.5 um; flat guess 88 um",
        "Standard uncertainty 2 um", "70 % lies within one and 96 % within two", "Computing time 1.75 s",
        "3 iterations, stopped by max iterations", "Printed volume 25 mm\u00b3 design 20 mm\u00b3 (+25 %)", "Printed mass 55 mg",
        "Highest point 500 um", "nested.step_m 5.000e-06", "feed", "ab" * 32, "nsfc 0.1.0", "landed 1, 1, none",
        "too high (-12, -10) (12, 8) 25 n/a 1.25", "corners", "rms px 0.25",
    ):  # fmt: skip
        assert said in text, said
    # Region: number, centre, size, area, volume, peak.
    peak = content.inspection.regions[0].peak_m * 1e6
    assert f"1 -16.4 4.2 1.6 0.9 1.4 0.65 {peak:.0f}" in text
    # Residual by wavelength, recomputed.
    measured = content.measured[0].astype(float)
    rest = 100 * np.linalg.norm(content.simulated[0] - measured) / np.linalg.norm(measured)
    assert f"610 {measured.mean():.4g}" in text and f" {rest:.3g} 530 " in text


def test_what_cannot_be_told_is_said(content):
    undecided, limit = np.zeros((32, 32), bool), np.full((32, 32), 2e-5)
    undecided[:5] = True  # 3 of the 30 rows that are judged
    limit[4, 4] = 7.5e-5
    found = dataclasses.replace(content.inspection, undecided=undecided, limit_m=limit)
    text = Page(report_text(dataclasses.replace(content, inspection=found))).text
    assert "Undecided 10 % of the judged area" in text
    assert "Tolerance \u00b120 um along the normal; vertically up to 75 um on flanks" in text
    assert "Undecided" not in Page(report_text(content)).text


def test_two_shares_of_the_image_say_what_pixels_they_are_of(content):
    """The line of trust judges at 32 pixels, the residual is of all 64: neither is taken for the other."""
    judged = content.record | {
        "trust": {"line": "explained within noise: 0.5 % of the image left", "pixels": 32, "floor_at_all": 0.0123}
    }
    text = Page(report_text(dataclasses.replace(content, record=judged, inspection=None))).text
    assert "its caustic differs from the image by 1.23 %, at all 64 pixels" in text
    assert "at all 64 pixels; the line above judges at 32; noise and simulation leave 1.23 % of all" in text
    assert "at all 64 pixels" not in Page(report_text(dataclasses.replace(content, inspection=None))).text


def test_only_pixels_that_count_make_the_residual(content):
    """A pixel that the mask excludes may be anything."""
    mask = np.ones(content.measured.shape, bool)
    mask[0, 3, 4] = False
    wrong = content.simulated.copy()
    wrong[0, 3, 4] = 1e6
    rows = [
        re.search(r"610 [\d.]+ [\d.]+ ([\d.]+) 530", Page(report_text(dataclasses.replace(content, **changes))).text)[1]
        for changes in ({"mask": mask}, {"mask": mask, "simulated": wrong})
    ]
    assert rows[0] == rows[1]


def test_arrays_of_the_script_are_the_result(content):
    record = Page(report_text(content)).record
    np.testing.assert_allclose(unpacked(record["maps"]["height"]["values"]), content.heights_m * 1e6, rtol=1e-6)
    np.testing.assert_allclose(unpacked(record["profiles"]["design"]), content.inspection.nominal_m * 1e6, rtol=1e-6)
    deviation = unpacked(record["maps"]["deviation"]["values"])
    assert np.isnan(deviation[:2]).all()
    np.testing.assert_allclose(deviation[2:], content.inspection.deviation_m[2:] * 1e6, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(unpacked(record["sigma"]), 2.0, rtol=1e-6)
    assert record["start"] == [20, 5] and record["plate_mm"] == [50, 30]
    assert record["maps"]["deviation"]["boxes"][0][4] == "1"
    np.testing.assert_allclose(record["maps"]["deviation"]["boxes"][0][:4], [-17.2, 3.8, -15.6, 4.7])
    for bins in record["histograms"].values():
        assert sum(bins["share"]) == pytest.approx(100)
    assert record["histograms"]["deviation"]["tolerance"] == pytest.approx(20)
    assert record["convergence"] == [
        {"stage": "one", "iteration": [2], "residual": [50.0]},
        {"stage": "two", "iteration": [3], "residual": [25.0]},
    ]


def test_nothing_is_fetched(content):
    page = Page(report_text(content))
    assert page.links
    anchors = {f"#{name}" for name in page.ids}
    assert all(link.startswith(("data:image/", "#")) for link in page.links)
    assert {link for link in page.links if link.startswith("#")} <= anchors
    policy = next(attrs["content"] for tag, attrs in page.tags if attrs.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy and "http" not in policy
    styles = re.findall(r"<style>(.*?)</style>", report_text(content), re.S)
    assert styles and not any("url(" in style or "@import" in style for style in styles)


def test_page_can_be_used_without_seeing_it(content):
    page = Page(report_text(content))
    assert ("html", {"lang": "en", "class": "no-script"}) in page.tags
    for tag, attrs in page.tags:
        if tag == "svg" or attrs.get("class") == "plot":
            assert attrs.get("aria-label"), (tag, attrs.get("id"))
        if tag == "th":
            assert attrs.get("scope")
    assert len(page.ids) == len(set(page.ids))
    labels = {attrs["for"] for tag, attrs in page.tags if tag == "label" and "for" in attrs}
    assert labels == {"row", "column"}


def test_what_people_gave_is_text(content):
    """Title, warnings, paths, names of stages and fibres, settings: none of it becomes markup or ends the script."""
    evil = "<script>alert(1)</script><!--'\"&"
    record = {
        **content.record, "method": evil, "warnings": [evil], "inputs": {evil: {"path": evil, "sha256": evil}},
        "settings": {evil: evil}, "history": [{"stage": evil, "residual": 0.5}], "stop_reason": evil,
    }  # fmt: skip
    found = content.inspection
    fibre = dataclasses.replace(found.fibres[0], name=evil)
    found = dataclasses.replace(found, reasons=(evil,), warnings=(evil,), fibres=(fibre,))
    stage = dataclasses.replace(content.stages[0], name=evil, text=evil, figures={evil: 1.0})
    text = report_text(dataclasses.replace(content, title=evil, record=record, inspection=found, stages=(stage,)))
    page = Page(text)
    assert [tag for tag, _ in page.tags].count("script") == 4
    assert "alert(1)</script>" not in text
    assert page.record["convergence"][0]["stage"] == evil
    assert page.text.count(evil) >= 10


def test_plotly_stands_between_tags_once(content):
    text = report_text(content)
    assert text.count("plotly.js v") == 1
    assert text.count("</script>") == 4


def test_pictures_show_row_0_on_top(content):
    """Light that grows with the row grows downwards, as a photo viewer shows the image's file."""
    rising = np.repeat(np.linspace(0.1, 2, 64)[None, :, None], 64, axis=2).repeat(3, axis=0)
    page = Page(report_text(dataclasses.replace(content, measured=rising, simulated=rising, stages=())))
    (measured,) = [attrs["href"] for tag, attrs in page.tags if tag == "image" and attrs["href"][11:15] == "jpeg"][1:2]
    codes = np.asarray(picture(measured).convert("L")).astype(float).mean(axis=1)
    assert codes[0] < 100 < 200 < codes[-1]


def test_maps_show_row_0_on_top(bare):
    """The picture without JavaScript, and its axis."""
    heights = np.zeros((32, 32))
    heights[:4] = 1e-3
    page = Page(report_text(dataclasses.replace(bare, heights_m=heights)))
    (shown,) = [attrs["href"] for tag, attrs in page.tags if tag == "image" and attrs["href"][11:14] == "png"][:1]
    light = np.asarray(picture(shown).convert("L")).astype(float).mean(axis=1)
    assert light[:4].min() > light[4:].max() + 50


@pytest.mark.parametrize("count", [1, 2, 31])
def test_any_number_of_wavelengths(bare, count):
    scene = Scene(
        height_samples=32,
        image_pixels=64,
        wavelengths_m=tuple(np.linspace(4e-7, 7e-7, count)),
        radiosity_W_m2=(1,) * count,
    )
    image = np.repeat(bare.measured[:1], count, axis=0)
    text = Page(report_text(dataclasses.replace(bare, scene=scene, measured=image, simulated=image))).text
    assert ("here there is one: grey" in text) == (count == 1)
    assert text.count(" 0 ") >= count


def test_missing_parts_are_left_out(bare):
    page = Page(report_text(bare))
    assert set(page.record["maps"]) == {"height"} and page.record["convergence"] == []
    assert set(page.ids) >= {"surface", "sections", "caustic", "record"}
    assert not set(page.ids) & {"deviation", "error", "uncertainty", "capture", "convergence"}
    assert "warning" not in page.text
    assert Page(report_text(dataclasses.replace(bare, record={}))).record["histograms"]["height"]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite(content, value):
    heights = content.heights_m.copy()
    heights[3, 4:9] = value
    images = content.measured.copy()
    images[:, 5, 6] = value
    sigma = content.uncertainty_m.copy()
    sigma[0, 0] = value
    sigma[0, 1] = 0
    broken = dataclasses.replace(
        content, heights_m=heights, measured=images, simulated=images[:, ::-1], uncertainty_m=sigma, reference_m=heights
    )
    record = Page(report_text(broken)).record
    assert np.isnan(unpacked(record["maps"]["height"]["values"])[3, 4:9]).all()
    assert np.isfinite(record["profile_range_um"]).all() and record["start"] == [20, 5]
    nothing = np.full_like(heights, value)
    report_text(dataclasses.replace(content, heights_m=nothing, uncertainty_m=nothing, measured=images * value))


def test_flat_plate_has_scales(bare):
    record = Page(report_text(dataclasses.replace(bare, heights_m=np.zeros((32, 32))))).record
    assert record["maps"]["height"]["high"] > record["maps"]["height"]["low"]
    assert record["surface"]["factor"] >= 1


def test_large_results_are_reduced_and_the_page_says_so(content):
    rng = np.random.default_rng(0)
    scene = Scene(height_samples=600, image_pixels=1600)
    heights = np.abs(rng.standard_normal((600, 600))) * 1e-4
    image = rng.random((3, 1600, 1600), dtype=np.float32)
    large = dataclasses.replace(
        content, scene=scene, heights_m=heights, measured=image, simulated=image[:, ::-1], uncertainty_m=heights,
        reference_m=None, inspection=None, stages=(),
    )  # fmt: skip
    text = report_text(large)
    page = Page(text)
    assert f"Of 600 samples per side, means of {MAP_SAMPLES} are shown" in page.text
    assert "means of 768 of 1600 pixels per side" in page.text
    shown = unpacked(page.record["maps"]["height"]["values"])
    assert shown.shape == (MAP_SAMPLES, MAP_SAMPLES)
    assert shown.mean() == pytest.approx(heights.mean() * 1e6, rel=1e-2)
    assert max(picture(attrs["href"]).width for tag, attrs in page.tags if tag == "image") <= 768


def test_page_is_small(content, tmp_path):
    """The usual size, with noise that compresses badly: at most 8 MB, which bounds the work of making it too."""
    rng = np.random.default_rng(0)
    image = rng.gamma(4.0, 0.25, (3, 512, 512)).astype(np.float32)
    heights = rng.random((128, 128)) * 1e-3
    stages = tuple(
        dataclasses.replace(content.stages[0], before=image, after=2 * image, marks_px=None) for _ in range(6)
    )
    usual = dataclasses.replace(
        content, scene=Scene(), measured=image, simulated=image[:, ::-1], heights_m=heights, uncertainty_m=heights,
        reference_m=heights[::-1], inspection=None, stages=stages,
    )  # fmt: skip
    write_report(tmp_path / "report.html", usual)
    assert (tmp_path / "report.html").stat().st_size < 8e6
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
