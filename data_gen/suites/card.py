"""The card of an exported suite: what it is, how it was made, how to be scored, under which licence."""

from collections.abc import Mapping, Sequence
from typing import Any

from data_gen.suites.case import Case

TEXT = """# nsfc bench, suite `{suite}`

{count} cases of caustics from 3D-printed glass plates, all simulated; nothing here was measured. The task: from one
capture, what is told of the bench, and nothing else, recover the relief of the plate.

| file | content |
|---|---|
| `captures/CASE.tif` | photo of the plate, 16 bits, a channel for each wavelength; row grows with +y |
| `captures/CASE_dark.tif` | the same with the light off |
| `captures/CASE_flat.tif` | the same with a plate without relief |
| `scenes/CASE.yaml` | plate, light, glass and screen as they are told, lengths in metres |
| `truth/CASE.npy` | heights above the base [m], float64, {samples} x {samples} samples at the centres of cells |
| `truth/CASE.json` | the bench as it is: **look at neither before you are scored** |
| `suite.json` | list of the cases |
| `SHA256SUMS` | checksums, `sha256sum -c SHA256SUMS` |

```text
irradiance = L (photo - dark) / (flat - dark)      L: scene.radiosity_W_m2; pixels at 65535 hold no measurement
```

## Scores

Write `CASE.npy` (or `.tif`), heights in metres, float32 or float64, into a folder, and `CASE_uncertainty.npy` beside
it if the method tells a standard uncertainty. `nsfc bench score FOLDER --suite {suite}` gives RMSE, RMSE after the best
move sideways (an image that is displaced cannot be told from a plate that is), slope error and what the uncertainty
covers. Each capture is to be used alone: rows of one suite may show the same plates.

`nsfc reconstruct captures/CASE.tif --capture captures/CASE_capture.yaml --config scenes/CASE.yaml -o found/CASE` is
how nsfc itself reads a case.

## Cases

| row | cases | what differs from what is told |
|---|---|---|
{rows}

## How it was made

Photon differentials, {photons} light paths per wavelength, others than reconstructions use; reliefs printed in
float32 on a CPU. Seeds are hashes of the configuration of a plate with a role that no data set for training has.
{camera}
nsfc {version}, code {code}, `nsfc bench export --suite {suite}`.

Not in it: light that meets the relief twice, diffraction, structure of the screen, a lens whose PSF changes over the
picture.

## Licence

{licence}, as nsfc itself. No person, place or product is in the data.
"""

WITH_CAMERA = """Photos pass through a model of a camera: PSF, shifts, colours, uneven and ambient light, mixing, shot
and read noise, speckle, dust, quantisation. The flat frame shows a plate without relief on the same bench."""
WITHOUT_CAMERA = """No camera is in it: irradiance with the noise of its row, as counts between a constant dark and a
constant flat frame."""


def card(cases: Sequence[Case], record: Mapping[str, Any]) -> str:
    """Text of the card, in Markdown.

    Args:
        cases: of one suite.
        record: gives version, licence, code and number of light paths.
    """
    rows: dict[str, list[Case]] = {}
    for case in cases:
        rows.setdefault(case.row, []).append(case)
    first = cases[0]
    return TEXT.format(
        suite=first.suite,
        count=len(cases),
        samples=first.told.height_samples,
        rows="\n".join(f"| `{row}` | {len(found)} | {found[0].title} |" for row, found in rows.items()),
        photons=f"{record['n_photons'] or first.photons.n_photons:,}",
        camera=WITHOUT_CAMERA if first.camera is None else WITH_CAMERA,
        version=record["version"],
        code=str(record["code"])[:12],
        licence=record["licence"],
    )
