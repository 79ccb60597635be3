"""Writes the page of a result."""

from typing import TYPE_CHECKING, Any

from warp_caustics.io.atomic import PathLike, write_text

if TYPE_CHECKING:
    from cli.report.content import ReportContent
    from cli.report.frame import Frame

_PACKAGE = "cli.report"


def write_report(path: PathLike, content: "ReportContent") -> None:
    """Write one self-contained HTML page, complete or not at all.

    Args:
        path: of the page.
        content: what it shows.
    """
    write_text(path, report_text(content))


def report_text(content: "ReportContent") -> str:
    """The page.

    Args:
        content: what it shows.
    """
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    from cli.figures import BRIGHTEST_PERCENT, DISPLAY_GAMMA
    from cli.report.arrays import MAP_SAMPLES, SURFACE_SAMPLES
    from cli.report.browser import browser_record
    from cli.report.maps import all_maps
    from cli.report.number import number
    from cli.report.pictures import CAUSTIC_PIXELS, JPEG_QUALITY, STAGE_PIXELS
    from cli.report.stages import shown_stages
    from cli.report.summary import (
        VERDICTS,
        care_line,
        coverage,
        headline,
        key_figures,
        no_uncertainty,
        rest_line,
        samples_line,
        trust_line,
    )
    from cli.report.tables import (
        bench_rows,
        fibre_rows,
        file_rows,
        record_groups,
        region_rows,
        scene_rows,
        wavelength_rows,
    )
    from warp_caustics.io.json_file import plain
    from warp_caustics.io.page import inline_script, page_file, render_page

    record: dict[str, Any] = plain(content.record)
    scene, found = content.scene, content.inspection
    maps = all_maps(content)
    lit, factor = _lit_frame(content)
    size_mm = scene.plate_size_m[0] * 1e3, scene.plate_size_m[1] * 1e3
    warnings = [*(record.get("warnings") or ()), *(found.warnings if found else ())]
    return render_page(
        _PACKAGE,
        "report.html.j2",
        title=content.title,
        own_style=page_file(_PACKAGE, "report.css"),
        headline=headline(content, record),
        verdict=(found.verdict, *VERDICTS[found.verdict]) if found else None,
        warnings=list(dict.fromkeys(str(warning) for warning in warnings)),
        figures=key_figures(content, record),
        maps=maps,
        frames={name: shown.frame(size_mm) for name, shown in maps.items()},
        lit=lit,
        lit_factor=number(factor, 2),
        coverage=coverage(record),
        trust=trust_line(record),
        rest=rest_line(record),
        no_uncertainty=no_uncertainty(record),
        care_line=care_line(record),
        caustics=_caustic_frames(content),
        samples_apart=_sample_frames(content),
        samples_line=samples_line(record),
        regions=region_rows(found) if found else [],
        bench=bench_rows(record),
        fibres=fibre_rows(found) if found else [],
        wavelengths=wavelength_rows(content),
        stages=shown_stages(content.stages, scene.wavelengths_m),
        steps=[] if content.stages else (record.get("calibration") or {}).get("steps") or [],
        scene=scene_rows(scene),
        files=file_rows(record),
        groups=record_groups(record),
        data=browser_record(content, maps, record),
        samples=max(content.heights_m.shape),
        pixels=max(content.measured.shape[-2:]),
        limits={"map": MAP_SAMPLES, "surface": SURFACE_SAMPLES, "caustic": CAUSTIC_PIXELS, "stage": STAGE_PIXELS},
        display={"gamma": DISPLAY_GAMMA, "percent": BRIGHTEST_PERCENT, "quality": JPEG_QUALITY},
        plotly=Markup(inline_script(get_plotlyjs())),
        script=Markup(inline_script(page_file(_PACKAGE, "report.js"))),
    )


def _lit_frame(content: "ReportContent") -> tuple["Frame", float]:
    """The relief as lit glass, for paper and for browsers without 3D, and the factor on its slopes."""
    import numpy as np

    from cli.lit_glass import exaggeration, lit_glass
    from cli.report.arrays import MAP_SAMPLES, reduced
    from cli.report.frame import plate_frame
    from cli.report.pictures import rgb_picture

    heights = np.nan_to_num(reduced(content.heights_m, MAP_SAMPLES))
    factor = exaggeration(heights, content.scene)
    uri = rgb_picture(lit_glass(heights, content.scene, factor))
    size_mm = content.scene.plate_size_m[0] * 1e3, content.scene.plate_size_m[1] * 1e3
    return plate_frame(uri, "The recovered relief as lit glass", size_mm, smooth=True), factor


def _sample_frames(content: "ReportContent") -> list["Frame"]:
    """What each sample has more than the result; none where they agree everywhere."""
    import numpy as np

    from cli.report.arrays import MAP_SAMPLES
    from cli.report.colours import DEVIATION
    from cli.report.frame import colour_bar, plate_frame
    from cli.report.pictures import map_picture

    if content.samples_m is None:
        return []
    apart = (content.samples_m - content.heights_m) * 1e6
    largest = float(np.abs(apart).max())
    if not largest > 0:
        return []
    # What differs is a few per cent of the plate: a scale by the largest would show its peak only.
    limit = float(np.quantile(np.abs(apart)[np.abs(apart) > 1e-3 * largest], 0.95))
    size_mm = content.scene.plate_size_m[0] * 1e3, content.scene.plate_size_m[1] * 1e3
    bar = colour_bar("sample - result [um]", -limit, limit, DEVIATION)
    return [
        plate_frame(
            map_picture(values, -limit, limit, DEVIATION, MAP_SAMPLES),
            f"Map of sample {number} minus the result",
            size_mm,
            bar=bar,
        )
        for number, values in enumerate(apart, 1)
    ]


def _caustic_frames(content: "ReportContent") -> dict[str, "Frame"]:
    """Measured, re-simulated, and their difference."""
    import numpy as np

    from cli.figures import rgb_channels, white_level
    from cli.report.colours import DEVIATION
    from cli.report.frame import colour_bar, plate_frame
    from cli.report.pictures import CAUSTIC_PIXELS, light_picture, map_picture

    scene = content.scene
    size_mm = scene.plate_size_m[0] * 1e3, scene.plate_size_m[1] * 1e3
    centre_mm = scene.screen_position_m[0] * 1e3, scene.screen_position_m[1] * 1e3
    channels = rgb_channels(scene.wavelengths_m, len(content.measured))
    white = white_level(content.measured[channels])
    frames = {}
    for name, image in (("measured", content.measured), ("simulated", content.simulated)):
        uri = light_picture(image, channels, white, CAUSTIC_PIXELS)
        frames[name] = plate_frame(uri, f"The {name} caustic", size_mm, centre_mm=centre_mm, smooth=True)
    difference = content.simulated.astype(np.float64) - content.measured
    if content.mask is not None:
        difference[~content.mask] = np.nan
    counted = np.isfinite(difference)
    with np.errstate(invalid="ignore"):
        rest = np.where(counted, difference, 0.0).sum(axis=0) / counted.sum(axis=0)
    limit = white_level(np.abs(rest))
    frames["residual"] = plate_frame(
        map_picture(rest, -limit, limit, DEVIATION, CAUSTIC_PIXELS),
        "Map of re-simulated minus measured light",
        size_mm,
        centre_mm=centre_mm,
        bar=colour_bar("simulated - measured [W/m\u00b2]", -limit, limit, DEVIATION),
        smooth=True,
    )
    return frames
