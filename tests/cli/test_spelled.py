"""A wrong value is told where it stands: in which file, or by the option that gave it."""

import pytest

from cli.main import main
from cli.spelled import spelled_in

CASES = {
    "file": (["config", "check", "{file}"], "scene: {image_pixels: -3}\n", "{file}: scene.image_pixels: Input should"),
    "--set over the file": (
        ["config", "check", "{file}", "--set", "scene.image_pixels=-4"],
        "scene: {image_pixels: 64}\n",
        "error: scene.image_pixels: Input should",
    ),
    "option of simulate": (
        ["simulate", "{file}", "-o", "x.tif", "--config", "small", "--n-photons", "-1"],
        "",
        "error: --n-photons: Input should be greater than or equal to 1, got -1",
    ),
    "option of train": (
        ["train", "direct", "--fresh", "-o", "run", "--config", "small", "--batch-size", "0"],
        "",
        "error: --batch-size: Input should be greater than or equal to 1, got 0",
    ),
    "option of search": (
        ["search", "denoiser", "--fresh", "-o", "s", "--n-trials", "1", "--max-epochs", "1", "--config", "small"],
        "",
        "error: --max-epochs: Input should be greater than or equal to 5, got 1",
    ),
    "file of a training": (
        ["train", "direct", "--fresh", "-o", "run", "--config", "{file}"],
        "training: {batch_size: 0}\n",
        "{file}: training.batch_size: Input should",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_where_a_wrong_value_stands(case, tmp_path, monkeypatch, capsys):
    words, text, expected = CASES[case]
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    assert main([word.format(file=file) for word in words]) == 3
    assert expected.format(file=file) in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.yaml"]


def test_the_last_source_that_has_a_key_wins():
    spelled = spelled_in([("a.yaml", {"scene": {"x": 1}}), ("b.yaml", {"scene": {"y": 1}}), ("", {"z": {"w": 1}})])
    assert [spelled(path) for path in ("scene.x.0", "scene.y", "scene", "z.w", "other")] == [
        "a.yaml: scene.x.0",
        "b.yaml: scene.y",
        "b.yaml: scene",
        "z.w",
        "other",
    ]
