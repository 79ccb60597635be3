"""Wrong configurations end in one line and an exit code of 2 to 6: never in a bug, never late, never large."""

import math
import random
from pathlib import Path

import pytest
from fuzzing import check, damaged, outcome

SCALARS = [
    "0", "-1", "1e400", "-1e400", "1e-400", "1e-30", "nan", ".nan", ".inf", "-.inf", "null", "~", "true", "yes", "''",
    '""', "3mm", "530nm", "-5um", "3 parsec", "1e999mm", "0x10", "1:30", "1_0", "!!int ''", "!!bool x", "!!float x",
    "!!timestamp x", "!!binary =", "!!set {a}", "!foo bar", "*a", "&a b", "[[]]", "{}", "[]", "{a: {b: c}}", "[1, [2]]",
    "2022-02-30", "'\\u0000'", '"\\uD800"', "9" * 5000, "-" + "9" * 400, "1." + "0" * 400, "[" * 200, "{" * 200 + "a",
    "a: b: c", "- -", "%", "@", "`", "\t", "<<", "? a", "'", '"', "|", ">", "\u2028", "\ufeff1", "=", "..", "1..2", "auto",
    "9223372036854775808", "18446744073709551616", "[9223372036854775808]", "1e308", "[1e308, -1e308]",
]  # fmt: skip


def leaves(tree, at=()):
    for key, value in tree.items():
        yield (*at, key)
        if isinstance(value, dict):
            yield from leaves(value, (*at, key))


def yaml_text(path, value):
    return (
        "".join(f"{'  ' * depth}{key}:{chr(10) if depth < len(path) - 1 else ' '}" for depth, key in enumerate(path))
        + value
    )


def test_configurations(tmp_path, rounds):
    from cli.config import Config, load_config

    rng = random.Random(1)
    paths = [
        *leaves(Config().model_dump(mode="json")),
        ("nosuch",),
        ("scene", "nosuch"),
        ("reconstruction", "options", "x"),
    ]
    tries = [(path, value) for path in paths for value in SCALARS]
    file = tmp_path / "config.yaml"
    for path, value in rng.sample(tries, min(len(tries), 300 * rounds)):
        check(lambda path=path, value=value: load_config(None, [f"{'.'.join(path)}={value}"]), (path, value))
        text = yaml_text(path, value)
        file.write_text(text, encoding="utf-8")
        check(lambda: load_config(str(file)), text)
    for _ in range(60 * rounds):
        content = damaged((Path(__file__).parents[2] / "configs/paper.yaml").read_bytes(), rng)
        file.write_bytes(content)
        check(lambda: load_config(str(file)), content)


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x, x, x]\nb: &b [*a, *a, *a]\nc: [*b, *b, *b]",
        "[" * 100_000,
        "{a: " * 20_000,
        "- " * 50_000 + "a",
        "scene: {image_pixels: " + "9" * 500_000 + "}",
        "scene:\n" + "".join(f"  k{i}: 1\n" for i in range(20_000)),
    ],
)
def test_bombs_of_yaml(tmp_path, text):
    from cli.config import load_config

    file = tmp_path / "bomb.yaml"
    file.write_text(text)
    assert outcome(lambda: load_config(str(file)))[0] == 3


@pytest.mark.parametrize(
    "setting", ["", "=", "a", "scene", ".=1", "scene.=1", "scene..x=1", "=1", "scene=1", "a=b=c", "\0=1"]
)
def test_settings_that_are_none(setting):
    from cli.config import load_config

    assert outcome(lambda: load_config(None, [setting]))[0] == 3


def test_scenes_at_the_edge():
    """What no plate of this world has."""
    from cli.config import load_config

    for value in ("1e-30", "0", "-1", "1e300", str(math.pi)):
        for key in ("scene.plate_size_m", "scene.base_thickness_m", "scene.screen_position_m", "scene.wavelengths_m"):
            text = f"[{value}, {value}]" if key.endswith("size_m") else f"[{value}]" if key.endswith("s_m") else value
            check(lambda key=key, text=text: load_config(None, [f"{key}={text}"]), (key, value))
