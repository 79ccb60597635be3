"""Configuration files: what is read, what is refused, and with which words."""

import hashlib
import json

import pytest
import yaml

from cli.config import Config, dataset_config, dump_config, load_config
from cli.main import main
from cli.shipped_files import config_path, shipped_configs
from data_gen.config import RasterConfig, ReliefConfig, RingsConfig
from nets.config import BEST_DENOISER, BEST_UPDATER
from warp_caustics.errors import InputError
from warp_caustics.scene import LATER_FIELDS, Scene


def load(tmp_path, text, *settings):
    path = tmp_path / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return load_config(str(path), settings)


def test_paper_is_tables_1_to_3():
    """Spelled out in the file, and equal to the defaults of the models."""
    config = load_config("paper")
    assert config.scene == Scene()
    assert config.reliefs == ReliefConfig()
    assert (config.denoiser, config.updater) == (BEST_DENOISER, BEST_UPDATER)
    simulation = config.simulation
    assert (simulation.placement, simulation.n_photons, simulation.smoothing) == ("random", 1_000_000, 16.0)


def test_paper_spells_out_every_key():
    written = yaml.safe_load(config_path("paper").read_text(encoding="utf-8"))
    assert paths(written) == paths(Config().model_dump())


def paths(tree, at=""):
    if not isinstance(tree, dict) or not tree:
        return {at}
    return set().union(*(paths(value, f"{at}/{key}") for key, value in tree.items()))


@pytest.mark.parametrize("name", ["paper", "small"])
def test_shipped_configs_load_by_name(name):
    assert name in shipped_configs()
    assert isinstance(load_config(name), Config)


@pytest.mark.parametrize(
    ("written", "expected"),
    [("1e6", 1_000_000), ("1E+6", 1_000_000), ("16e6", 16_000_000), ("1.5e3", 1500), ("010", 10), ("123", 123)],
)
def test_numbers_are_numbers(tmp_path, written, expected):
    """PyYAML by itself reads 1e6 as a string and 010 as 8."""
    assert load(tmp_path, f"simulation: {{n_photons: {written}}}").simulation.n_photons == expected


def test_exponents_without_a_point_are_floats(tmp_path):
    config = load(tmp_path, "scene: {screen_position_m: [0, 0, -5e-2]}\nupdater: {lambda_tv: 5e-10}")
    assert config.scene.screen_position_m[2] == -0.05
    assert config.updater.lambda_tv == 5e-10
    with pytest.raises(AssertionError):  # the trap is real
        assert yaml.safe_load("5e-10") == 5e-10


def test_other_values_of_a_section_keep_their_defaults(tmp_path):
    config = load(tmp_path, "scene: {image_pixels: 64}\nupdater: {k_up: 5}\nreliefs:\n  perturbation: {}\n")
    assert config.scene == Scene(image_pixels=64)
    assert config.updater == BEST_UPDATER.model_copy(update={"k_up": 5})
    assert config.reliefs == ReliefConfig()


def sections(tree, at=""):
    """Dotted names of all sections of a configuration."""
    below = {f"{at}{key}": value for key, value in tree.items() if isinstance(value, dict)}
    return [*below, *(name for key, value in below.items() for name in sections(value, f"{key}."))]


@pytest.mark.parametrize("name", sections(Config().model_dump()))
def test_null_is_no_section(tmp_path, name):
    """It looked like switching something off, and changed nothing."""
    off = "reliefs.variety, reliefs.making, data.bench, training.bench, training.camera"
    line = f"is null; of sections only {off} can be off: leave it out"
    with pytest.raises(InputError, match=f"^--set {name}=null: {name} {line}"):
        load_config(None, [f"{name}=null"])
    *above, last = name.split(".")
    text = "".join(f"{'  ' * depth}{part}:\n" for depth, part in enumerate([*above, last]))
    with pytest.raises(InputError, match=rf"config.yaml: {name} {line} for its defaults, or give .") as error:
        load(tmp_path, text)
    assert "\n" not in str(error.value)


def test_null_below_a_section_that_may_be_off_is_refused_as_well():
    with pytest.raises(InputError, match=r"data.bench.set_up is null; .* as data.bench.set_up.gap_offset_m$"):
        load_config(None, ["data.bench.set_up=null"])
    assert load_config(None, ["data.bench.set_up.gap_offset_m=[0, 1e-5]", "data.bench=null"]).data.bench is None


def test_null_takes_back_an_option_of_a_method(tmp_path):
    """Options belong to their method: whatever their value was, null replaces it."""
    config = load(tmp_path, "reconstruction: {options: {start: {kind: flat}}}", "reconstruction.options.start=null")
    assert config.reconstruction.options == {"start": None}


def test_settings_win_over_the_file_and_are_typed_like_yaml(tmp_path):
    config = load(
        tmp_path, "scene: {image_pixels: 64}",
        "scene.image_pixels=256", "simulation.n_photons=1e5", "scene.glass=n_bk7", "scene.radiosity_W_m2=[1, 2, 3]",
        "reconstruction.options.max_iterations=5",
    )  # fmt: skip
    assert config.scene == Scene(image_pixels=256, glass="n_bk7", radiosity_W_m2=(1, 2, 3))
    assert config.simulation.n_photons == 100_000
    assert config.reconstruction.options == {"max_iterations": 5}


def test_dump_reads_back_unchanged(tmp_path):
    config = load_config("paper", ["reconstruction.options.tolerance=1e-7", "scene.wavelengths_m=[1e-6, 5e-7, 4.3e-7]"])
    text = dump_config(config)
    assert load(tmp_path, text) == config
    assert yaml.safe_load(text)["reconstruction"]["options"]["tolerance"] == 1e-7
    assert dump_config(load(tmp_path, text)) == text


def test_fingerprint_changes_with_a_value_and_not_with_its_spelling(tmp_path):
    one = load(tmp_path, "simulation: {n_photons: 1e6}\nscene: {glass: n_bk7}").fingerprint()
    assert one == load(tmp_path, "scene: {glass: n_bk7}\nsimulation: {n_photons: 1000000}").fingerprint()
    assert one != load(tmp_path, "scene: {glass: n_bk7}\nsimulation: {n_photons: 1000001}").fingerprint()


def test_configuration_is_immutable():
    with pytest.raises(ValueError, match="frozen"):
        Config().scene = Scene()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("scene: {base_thicknes_m: 3e-3}", "scene.base_thicknes_m: unknown key; did you mean 'base_thickness_m'"),
        ("scen: {}", "scen: unknown key; did you mean 'scene'"),
        ("reliefs: {perturbation: {line_with_m: [0, 1]}}", "did you mean 'line_width_m'"),
        ("scene: {base_thickness_m: 3}", "did you mean 0.003 (3 mm)"),
        ("scene: {wavelengths_m: [610, 530, 430]}", "did you mean 6.1e-07 (610 nm)"),
        ("scene: {wavelengths_m: [610e-9]}", "3 radiosities for 1 wavelengths"),
        ("scene: {image_pixels: 0}", "scene.image_pixels"),
        ("scene: {image_pixels: .nan}", "scene.image_pixels"),
        ("scene: {screen_position_m: [0, 0, -.inf]}", "scene.screen_position_m"),
        ("scene: {glass: [1]}", "scene.glass"),
        ("scene: 5", "scene is a section"),
        ("scene: {image_pixels: {a: 1}}", "image_pixels has no keys of its own"),
        ("simulation: {n_photons: 0}", "simulation.n_photons"),
        ("simulation: {n_photons: 1.5}", "simulation.n_photons"),
        ("simulation: {seed: -1}", "simulation.seed"),
        ("simulation: {preset: papr}", "did you mean 'paper'"),
        ("denoiser: {k_down: 40}", "between 2 and 11"),
        ("scene: {image_pixels: 64, image_pixels: 65}", "'image_pixels' is given twice"),
        ("scene:\n  glass: n_bk7\nscene:\n  image_pixels: 4", "line 3: key 'scene' is given twice"),
        ("a: &x [1]\nb: *x", "aliases"),
        ("scene: {", "config.yaml"),
        ("- 1", "holds no keys"),
        ("just text", "holds no keys"),
        ("? [1, 2]\n: 3", "a key must be a word"),
        ("scene: !!python/object/apply:os.system ['true']", "tags (!!python/object/apply:os.system) are not read; leave it out"),
        ("\0", "config.yaml"),
        ("reconstruction: " + "[" * 5000, "config.yaml"),
    ],
)  # fmt: skip
def test_bad_files_are_refused_in_one_line(tmp_path, text, reason):
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    assert reason in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("scene.image_pixels", "is not KEY=VALUE"),
        ("=3", "is not KEY=VALUE"),
        ("scene..image_pixels=3", "is not KEY=VALUE"),
        ("scene.pixels=3", "did you mean 'image_pixels'"),
        ("scene.wavelengths_m.0=3", "wavelengths_m has no keys of its own"),
        ("scene=3", "scene is a section"),
        ("scene.image_pixels=[", "--set scene.image_pixels=["),
    ],
)
def test_bad_settings_are_refused(setting, reason):
    with pytest.raises(InputError) as caught:
        load_config(None, [setting])
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("source", "reason"),
    [("papr", "did you mean 'paper'"), ("zzz", "use one of family, paper, small"), ("./none.yaml", "does not exist")],
)
def test_missing_files_are_named(source, reason):
    with pytest.raises(InputError) as caught:
        load_config(source)
    assert reason in str(caught.value)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00s", b"x" * 2_000_000])
def test_files_that_are_no_text_or_huge_are_refused(tmp_path, content):
    path = tmp_path / "config.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load_config(str(path))


def test_another_pattern_has_other_keys(tmp_path):
    """Keys are those of the pattern that is named; with its own defaults for the rest."""
    config = load(tmp_path, "reliefs: {pattern: raster, spacing_m: [1e-3, 2e-3]}")
    assert isinstance(config.reliefs, RasterConfig) and config.reliefs.spacing_m == (1e-3, 2e-3)
    rings = load_config(None, ["reliefs.pattern=rings", "reliefs.line_count=[2, 2]"])
    assert isinstance(rings.reliefs, RingsConfig) and rings.reliefs.line_count == (2, 2)
    assert load_config(None, ["reliefs.line_count=[3, 3]"]).reliefs.line_count == (3, 3)
    with pytest.raises(InputError, match="spacing_m"):
        load(tmp_path, "reliefs: {spacing_m: [1e-3, 2e-3]}")
    with pytest.raises(InputError, match="spiral"):
        load_config(None, ["reliefs.pattern=spiral"])
    # What is written out comes back.
    path = tmp_path / "again.yaml"
    path.write_text(dump_config(config), encoding="utf-8")
    assert load_config(str(path)) == config


def test_data_sets_take_what_is_given_and_suit_their_kind_otherwise():
    few = load_config(None, ["data.noisy.n_photons=1000"])
    denoiser = dataset_config(few, kind="denoiser", n_samples=3, seed=1)
    assert (denoiser.noisy.preset, denoiser.noisy.n_photons, denoiser.clean.n_photons) == ("paper", 1000, 16_000_000)
    updater = dataset_config(few, kind="updater", n_samples=3, seed=1)
    assert (updater.noisy.preset, updater.noisy.n_photons, updater.clean.n_photons) == ("lattice", 1000, None)
    paper = dataset_config(load_config("paper"), kind="updater", n_samples=3)
    assert (paper.noisy.preset, paper.clean.n_photons) == ("paper", 16_000_000)


def test_sections_that_are_off_are_switched_on_by_a_key_and_off_by_null():
    """Making and variety of prints; a file may leave the rest of a section to its defaults."""
    on = load_config(None, ["reliefs.making.passes=[1, 6]", "reliefs.making.fibre_diameter_m=[0.4mm, 0.5mm]"])
    assert on.reliefs.making.passes == (1, 6) and on.reliefs.making.fibre_diameter_m == (4e-4, 5e-4)
    assert on.reliefs.making.sections == ("cap",)
    off = load_config(None, ["reliefs.making.passes=[1, 6]", "reliefs.making=null"])
    assert off == load_config() and on.fingerprint() != off.fingerprint()
    assert load_config(None, ["reliefs.variety.bow_m=20um"]).reliefs.variety.bow_m == 2e-5
    with pytest.raises(InputError, match="making.pases: unknown key; did you mean 'passes'"):
        load_config(None, ["reliefs.making.pases=[1, 6]"])
    with pytest.raises(InputError, match="variety and making both draw sections"):
        load_config(None, ["reliefs.making.passes=[1, 6]", "reliefs.variety.bow_m=20um"])
    with pytest.raises(InputError, match="114.6 degrees, is above 90"):
        load_config(None, ["reliefs.making.contact_angle_rad=[1, 2]"])


def test_what_is_off_is_not_in_the_fingerprint():
    """Results name the fingerprint of configurations from before prints could be made otherwise, benches drawn and GPUs
    repeat."""
    tree = Config().model_dump(mode="json")
    assert tree["reliefs"].pop("making") is None
    assert tree["data"].pop("bench") is None
    assert tree["simulation"].pop("deterministic") is False
    for field in LATER_FIELDS:
        tree["scene"].pop(field)
    assert Config().fingerprint() == hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("scene.base_thickness_m=3", "did you mean 0.003 (3 mm)?"),
        ("scene.base_thickness_m=1e9", "1e+09 m is not between 0 (exclusive) and 1 m; give metres"),
        ("scene.wavelengths_m=610nm", "give a list, as [1, 2, 3], of one value too: [1]"),
    ],
)
def test_a_mend_is_one_that_would_be_taken(setting, told, capsys):
    """No length is guessed that is wrong as well; a single value is told to be a list."""
    assert main(["config", "show", "--set", setting]) == 3
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
