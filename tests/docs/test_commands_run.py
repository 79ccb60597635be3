"""Commands of the pages are run, one after the other, in a folder of small files; those that take long elsewhere."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.docs.pages import DOCS, NSFC, ROOT, SHELL, ids
from tests.quick_figures import quick_figures
from tests.upright import upright_only

__all__ = ["quick_figures", "upright_only"]

SMALL = ("--set", "scene.height_samples=32", "--set", "scene.image_pixels=64")

RUN = [
    # Command, what is changed to make it quick, what is added.
    (r"nsfc (env|config) ", {}, ()),
    (r"nsfc weights ", {}, ()),
    (r"nsfc plan ", {}, ()),
    (
        r"nsfc calibrate print.tif .*scene",
        {},
        ("--free", "gap_m", "--iterations", "1", "--no-advice", "--border", "4", "--finest", "32", *SMALL),
    ),
    (r"nsfc calibrate ", None, "photos of the reader's own; tests/cli/test_calibrate.py runs small ones"),
    (r"nsfc setup .*lines", None, "a list of lines of the reader's own; tests/cli/test_setup.py has one"),
    (r"nsfc setup ", {}, ("--border", "4", "--unknown-heights", "1", *SMALL)),
    (r"nsfc simulate .*--camera \./", None, "a file of the page; tests/cli/test_simulate_camera.py reads it"),
    (r"nsfc simulate examples/", None, "files of the checkout; tests/cli/test_simulate.py runs it"),
    (r"nsfc simulate ", {}, SMALL),
    (r"nsfc data build .*--scheduler", None, "needs a Dask scheduler; tests/data_gen/store/test_cluster.py has one"),
    (r"nsfc data build updater sets/", {r"--n \d+": "--n 2"}, SMALL),
    (r"nsfc data build ", {r"--n \d+": "--n 2"}, (*SMALL, "--workers", "0")),
    (r"nsfc data testset ", None, "16 million photons per field; tests/cli/test_data.py runs a small one"),
    (r"nsfc data ", {}, ()),
    (
        r"nsfc reconstruct .*--(corners|distortion|mixing|capture)",
        None,
        "needs a photo of a screen; tests/warp_caustics/capture makes some",
    ),
    (r"nsfc reconstruct .*--method fibres", None, "needs an image of 256 pixels, and a minute; the demo runs it"),
    (r"nsfc (reconstruct|capture) examples/", None, "files of the checkout; tests/test_lab.py runs them"),
    (
        r"nsfc reconstruct .*--set reconstruction.options.max_iterations",
        {r"max_iterations=\d+": "max_iterations=2"},
        SMALL,
    ),
    (r"nsfc reconstruct ", {}, ("--max-iterations", "2", *SMALL)),
    (r"nsfc .*[$*]", None, "files of the reader's own"),
    (r"nsfc design ", {}, ("--max-iterations", "2", *SMALL)),
    (
        r"nsfc capture .*--(corners|distortion|mixing|capture|exposure-times)",
        None,
        "needs a photo of a screen; tests/warp_caustics/capture makes some",
    ),
    (r"nsfc capture ", {}, SMALL),
    (r"nsfc inspect ", None, "needs a network or minutes; tests/cli/inspection runs small ones"),
    (r"nsfc bench list", {}, ()),
    (r"nsfc bench ", None, "millions of photons per case; tests/cli/test_bench.py runs small ones"),
    (r"nsfc compare ", None, "minutes; tests/cli/test_compare.py runs small ones"),
    (r"nsfc train ", None, "minutes to hours; tests/cli/test_train.py runs small ones"),
    (r"nsfc search ", None, "minutes to hours; tests/cli/test_search.py runs small ones"),
]
"""Which documented commands are run (changes: dict; added options), and why others are only parsed (None; reason)."""


def row_of(words):
    """The row of RUN that decides about a command."""
    line = " ".join(words) + " "
    return next((row for row in RUN if re.match(row[0], line)), (line, None, None))


@pytest.mark.parametrize(("block", "words"), NSFC, ids=ids(NSFC))
def test_it_is_decided_whether_a_command_is_run(block, words):
    _, changes, rest = row_of(words)
    assert changes is not None or rest, "give it a row in RUN"
    if changes is None:
        assert all((ROOT / name).exists() for name in re.findall(r"tests/[\w/.]*\w", rest)), rest


def setup_of_the_photo_page():
    """The YAML file that photo.md tells a reader to write, and its name."""
    text = (DOCS / "photo.md").read_text(encoding="utf-8")
    (found,) = re.findall(r"^```yaml\n# (\S+)\n(.*?)^```$", text, re.M | re.S)
    return found


def workspace(folder, block):
    """Files of the names that a block's commands read, for small plates."""
    import torch

    from cli.config import load_config
    from warp_caustics import CausticSimulator
    from warp_caustics.io import write_image
    from warp_caustics.prints.line import Line, line_relief
    from warp_caustics.prints.line_list import write_lines

    name, content = setup_of_the_photo_page()
    (folder / name).write_text(content, encoding="utf-8")
    scene = load_config(str(folder / name) if name in block.text else None, SMALL[1::2]).scene
    heights = line_relief([Line((-0.012, -0.01), (0.012, 0.008), 6e-3, 1e-4)], 32, scene.plate_size_m)
    caustic = CausticSimulator(scene)(torch.from_numpy(heights).float()).numpy()
    outputs = set()
    for words in block.commands():
        if "-o" in words and row_of(words)[1] is not None:
            outputs.add(words[words.index("-o") + 1])
        for word in words:
            path = folder / word
            if outputs & {word, *map(str, Path(word).parents)} or path.exists() or Path(word).is_absolute():
                continue
            if word.endswith(".tif"):
                light = {"dark.tif": 0 * caustic, "flat.tif": 0 * caustic + 1}.get(word, caustic)
                counts = np.round(200 + 15_000 * light).astype(np.uint16)
                write_image(path, counts, wavelengths_m=scene.wavelengths_m)
            elif word.endswith(".png"):
                write_image(path, np.pad(np.full((40, 40), 255, np.uint8), 12, constant_values=60))
            elif word.endswith(".npy"):
                np.save(path, heights)
            elif word.endswith(".csv"):
                write_lines(path, [Line((-0.012, -0.01), (0.012, 0.008), 6e-3, 1e-4)])
            elif word.endswith(".safetensors"):
                tiny_weights(path, scene)


def tiny_weights(path, scene):
    import nets
    from nets.config import DenoiserConfig, NetworkConfig

    path.parent.mkdir(exist_ok=True)
    numbers = NetworkConfig(learning_rate=1e-3, c_init=2, nonlinearity="ReLU", k_down=2, k_up=2, m_s=1, n_s=1)
    module = nets.build(DenoiserConfig(network=numbers), scene)
    nets.save_weights(path, module, scene=scene, data_fingerprint=None, training={})


def runnable():
    """Blocks with the commands to run of each; a line that stands on several pages is run once."""
    done, chosen = set(), []
    for block in SHELL:
        lines = [w for w in block.commands() if w[0] == "nsfc" and row_of(w)[1] is not None and tuple(w) not in done]
        done.update(tuple(words) for words in lines if words[1] == "reconstruct")
        if lines:
            chosen.append((block, lines))
    return chosen


RUNNABLE = runnable()


@pytest.mark.parametrize(("block", "lines"), RUNNABLE, ids=[block.name for block, _ in RUNNABLE])
def test_commands_run(block, lines, tmp_path, monkeypatch, capfd):
    """One after the other, as a reader would, in a folder that holds small files of the names they read."""
    from cli.main import main

    monkeypatch.chdir(tmp_path)
    workspace(tmp_path, block)
    for words in lines:
        _, changes, added = row_of(words)
        line = shlex.join(words)
        for pattern, replacement in changes.items():
            line = re.sub(pattern, replacement, line, count=1)
        # Folders of the examples lie here.
        arguments = [word.replace("/data/", f"{tmp_path}/") for word in shlex.split(line)[1:]] + list(added)
        for word in words:
            if "/" in word and word == Path(word).as_posix() and not Path(word).is_absolute():
                (tmp_path / word).parent.mkdir(parents=True, exist_ok=True)
        written = [Path(arguments[arguments.index(option) + 1]) for option in ("-o", "--stages") if option in arguments]
        if any(path.exists() for path in written):
            arguments.append("--force")
        code = main(arguments)
        assert code == 0, f"{shlex.join(arguments)}\n{capfd.readouterr().err}"
