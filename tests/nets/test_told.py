"""What networks are told, how it turns with a plate, and pictures without what a flat plate would show."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

import nets
from data_gen.bench_ranges import bench_scene
from nets.architecture import architecture_record, build, parse_architecture
from nets.flat_light import FlatLight, rectified, window_of
from nets.residual_config import DirectConfig, UnrolledConfig
from nets.rounded_weights import STEP
from nets.symmetries import all_symmetries, transformed
from nets.told import ToldTable, bench_values, dropped, filled, told_count, told_of, told_parameters, turned
from nets.told_maps import ToldMaps
from nets.weights import load_weights
from nets.weights_file import decode
from tests.nets.conftest import BACKBONE
from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.errors import InputError
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=128)
IDEAL = {
    "gap_m": 1e-6, "base_thickness_m": 3e-3, "index_offset": 0.0, "dispersion_scale": 1.0, "is_point_source": 0.0,
    "lamp_distance_m": 0.0, "lamp_half_angle_rad": 0.0, "tilt_x_rad": 0.0, "tilt_y_rad": 0.0, "fresnel": 0.0,
}  # fmt: skip
TILTED = IDEAL | {"tilt_x_rad": 0.03, "tilt_y_rad": -0.011, "gap_m": 2e-3, "base_thickness_m": 5e-3}
NEAR = TILTED | {"is_point_source": 1.0, "lamp_distance_m": 0.25, "lamp_half_angle_rad": 0.005}
LINES = [Line((-0.015, -0.01), (0.012, 0.008), 8e-3, 2.5e-3), Line((0.015, -0.015), (0.002, 0.018), 6e-3, 1.5e-3)]


def bench(numbers, scene=SCENE):
    return bench_scene(scene, **numbers)


def relief(scene=SCENE):
    return torch.tensor(line_relief(LINES, scene.height_samples, scene.plate_size_m), dtype=torch.float32)


def simulated(scene, heights):
    with torch.no_grad():
        return CausticSimulator(scene, "lattice")(heights)


def values_of(scene):
    return torch.tensor([[*bench_values(scene), 0.0, 0.0]])


def landed(scene, x, wavelength):
    """Where light through (x_0, x_1) of the flat plate's top lands, by Snell's law, float64."""
    if scene.is_collimated:
        direction = np.array([*(math.tan(a) for a in scene.light_tilt_rad), -1.0])
    else:
        direction = np.array([*x, scene.base_thickness_m]) - np.array(scene.light_position_m)
    direction = direction / np.linalg.norm(direction)
    place, before = np.array(x, dtype=float), 1.0
    legs = ((scene.glass_indices, scene.base_thickness_m), (scene.exit_indices, -scene.screen_position_m[2]))
    for indices, depth in legs:
        tangential = direction[:2] * before / indices[wavelength]
        direction = np.array([*tangential, -math.sqrt(1 - tangential @ tangential)])
        place, before = place + direction[:2] / -direction[2] * depth, indices[wavelength]
    return place


def test_the_table_has_numbers_of_order_one():
    rows = told_parameters(SCENE)
    assert len(rows) == told_count(3) == 11
    table = ToldTable(SCENE)
    none, _ = told_of(SCENE, table)
    for edge in (TILTED, NEAR, IDEAL | {"index_offset": 0.06, "dispersion_scale": 0.0, "base_thickness_m": 6e-3}):
        values, known = told_of(bench(edge), table, blur_px=2.0, noise=0.1)
        given = dropped(values, known, table)
        assert given.shape == (1, 22) and 0.3 < given[:, :11].abs().max() < 2.5
        assert (given[:, 11:] == 1).all()
        assert (dropped(values, torch.zeros_like(known), table) == 0).all()
        assert (filled(values, torch.zeros_like(known), table) == none).all()
    assert (dropped(*told_of(SCENE, table), table)[:, :11] == 0).all()
    assert told_of(SCENE, table)[1].sum() == 9  # neither blur nor noise
    assert len(told_parameters(SCENE.model_copy(update={"wavelengths_m": (5e-7,), "radiosity_W_m2": (1.0,)}))) == 9


@pytest.mark.parametrize("numbers", [TILTED, NEAR], ids=["tilted", "near"])
@pytest.mark.parametrize("which", range(8))
def test_told_values_turn_with_the_plate(numbers, which):
    """The picture of the turned plate on the bench that the turned values are of is the turned picture."""
    table, symmetry = ToldTable(SCENE), all_symmetries(SCENE)[:, which : which + 1]
    # Without the window that follows the light: that is the camera's.
    scene = bench(numbers).model_copy(update={"screen_position_m": (0.0, 0.0, -2e-3)})
    values = turned(values_of(scene), symmetry, table)
    x, y = values[0, table.x].item(), values[0, table.y].item()
    distance = scene.light_distance_m
    changed = (
        {"light_tilt_rad": (math.atan(x), math.atan(y))}
        if scene.is_collimated
        else {"light_position_m": (-x * distance, -y * distance, scene.light_position_m[2])}
    )
    expected = simulated(scene.model_copy(update=changed), transformed(relief()[None], symmetry)[0])
    found = transformed(simulated(scene, relief())[None], symmetry)[0]
    # Photons lie on a lattice that is not quite the same when it is turned.
    assert (found - expected).norm() < 0.02 * expected.norm()
    straight = simulated(scene.model_copy(update=changed), relief())
    if which:
        assert (found - straight).norm() > 0.1 * expected.norm()


@pytest.mark.parametrize("numbers", [TILTED, NEAR], ids=["tilted", "near"])
def test_places_are_where_snells_law_says(numbers):
    scene = bench(numbers, Scene())
    shift, scale = FlatLight(ToldTable(Scene())).places(values_of(scene))
    pixel, edge = scene.pixel_size_m[0], 0.9 * scene.plate_size_m[0] / 2
    for wavelength in range(3):
        for start in ((0.0, 0.0), (edge, 0.0), (0.0, -edge), (-edge, edge)):
            seen = (landed(scene, start, wavelength) - np.array(scene.screen_position_m[:2])) / pixel
            back = seen * (1 + scale[0, wavelength].item()) + shift[0, wavelength].numpy()
            assert np.abs(back - np.array(start) / pixel).max() < (1e-3 if scene.is_collimated else 0.05)


@pytest.mark.parametrize("numbers", [TILTED, NEAR, NEAR | {"tilt_x_rad": 0.0, "tilt_y_rad": 0.0}])
def test_level_is_what_a_flat_plate_shows(numbers):
    scene = bench(numbers | {"lamp_half_angle_rad": 0.0})
    flat = simulated(scene, torch.zeros(32, 32))
    level = FlatLight(ToldTable(SCENE)).level(values_of(scene))[0]
    inner = (flat / level)[:, 6:-6, 6:-6]
    assert (inner - 1).abs().max() < 2e-3
    if not scene.is_collimated:
        assert (flat[:, 6:-6, 6:-6] - 1).abs().max() > 0.05


@pytest.mark.parametrize("numbers", [TILTED, NEAR], ids=["tilted", "near"])
def test_a_rectified_picture_is_that_of_straight_light(numbers):
    """A weak relief moves light about as straight light: the picture is nearer to that by far, and in its place."""
    grids = Scene(height_samples=32, image_pixels=256)
    # The window stays below the plate, and the light lands beside it.
    scene = bench(numbers | {"lamp_half_angle_rad": 0.0}, grids)
    scene = scene.model_copy(update={"screen_position_m": (0.0, 0.0, -2e-3)})
    plain = bench(numbers | {"is_point_source": 0.0, "tilt_x_rad": 0.0, "tilt_y_rad": 0.0}, scene)
    plain = plain.model_copy(update={"light_tilt_rad": (0.0, 0.0), "screen_position_m": (0.0, 0.0, -2e-3)})
    heights = relief(scene) * 0.05
    light = FlatLight(ToldTable(scene))
    levelled = simulated(scene, heights) / light.level(values_of(scene))[0]
    wanted = simulated(plain, heights)[:, 8:-8, 8:-8] - 1
    before = (levelled[:, 8:-8, 8:-8] - 1 - wanted).norm() / wanted.norm()
    after = (rectified(levelled, scene)[:, 8:-8, 8:-8] - 1 - wanted).norm() / wanted.norm()
    assert after < 0.3 * before and after < 0.1


def test_heights_are_scaled_by_how_far_light_goes():
    """A weak relief shows on a bench what a relief over the scale shows on the network's own scene."""
    scene = Scene(height_samples=32, image_pixels=256)
    bench_numbers = IDEAL | {"gap_m": 1e-3, "base_thickness_m": 5e-3, "index_offset": 0.05, "dispersion_scale": 0.3}
    other = bench(bench_numbers, scene)
    scale = FlatLight(ToldTable(scene)).height_scale(values_of(other)).item()
    assert scale < 0.5
    heights = relief(scene) * 0.02
    seen, own, unscaled = (
        simulated(where, what)[1] - 1 for where, what in ((other, heights), (scene, heights / scale), (scene, heights))
    )
    assert (seen - own).norm() < 0.05 * own.norm() and (seen - unscaled).norm() > 0.4 * own.norm()
    assert FlatLight(ToldTable(scene)).height_scale(values_of(scene)).item() == 1.0


def test_the_default_scene_is_left_alone():
    image = torch.rand(3, 128, 128)
    assert rectified(image, SCENE) is image
    assert rectified(image, bench(IDEAL | {"gap_m": 3e-3, "lamp_half_angle_rad": 0.01})) is image
    assert (FlatLight(ToldTable(SCENE)).level(values_of(SCENE)) == 1).all()


def test_a_window_aside_is_moved_back():
    aside = SCENE.model_copy(update={"screen_position_m": (4 * SCENE.pixel_size_m[0], 0.0, -1e-6)})
    assert window_of(aside)[0] == pytest.approx(4 * SCENE.pixel_size_m[0], rel=1e-6)
    assert np.abs(window_of(bench(TILTED))).max() < 1e-9 and np.abs(window_of(bench(NEAR))).max() < 1e-9
    straight, seen = simulated(SCENE, relief()), simulated(aside, relief())
    moved = rectified(seen, aside)
    inner = slice(10, -10)
    assert (moved - straight)[:, inner, inner].norm() < 0.02 * straight[:, inner, inner].norm()
    assert (seen - straight)[:, inner, inner].norm() > 0.1 * straight[:, inner, inner].norm()


# -- networks ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def configs(scene):
    return DirectConfig(backbone=BACKBONE), DirectConfig(backbone=BACKBONE.model_copy(update={"conditions": 11}))


def test_film_starts_as_nothing_and_learns(scene, configs):
    torch.manual_seed(0)
    plain = build(configs[0], scene)
    torch.manual_seed(0)
    network = build(configs[1], scene)
    extra = network.load_state_dict(plain.state_dict(), strict=False)
    assert not extra.unexpected_keys and all("film" in key or "code" in key for key in extra.missing_keys)
    for network_part in (plain, network):
        torch.manual_seed(1)
        for name, parameter in network_part.named_parameters():
            if "film" not in name and "code" not in name:
                torch.nn.init.normal_(parameter, std=0.1)
    image, told = torch.rand(2, 3, 64, 64), torch.randn(2, 22)
    assert torch.equal(network(image, told), plain(image)) and torch.equal(network(image), plain(image))
    network(image, told).square().sum().backward()
    assert all(p.grad.any() for name, p in network.named_parameters() if "film.linear" in name)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if "film" in name:
                parameter.normal_(std=0.1)
    assert not torch.allclose(network(image, told), network(image, -told))
    assert torch.equal(network(image), network(image, torch.zeros(2, 22)))


def told_by(configs, way):
    return configs[1].model_copy(update={"told_by": way})


def test_maps_start_as_nothing_and_learn(scene, configs):
    networks = []
    for config in (configs[0], told_by(configs, "maps"), told_by(configs, "picture")):
        torch.manual_seed(0)
        networks.append(build(config, scene))
    plain, network, by_picture = networks
    weights = plain.state_dict()
    assert set(network.state_dict()) - set(weights) == {"maps.weighted.weight"}
    assert all(torch.equal(values, network.state_dict()[name]) for name, values in weights.items())
    for part in networks:
        torch.manual_seed(1)
        for name, parameter in part.named_parameters():
            if "maps" not in name:
                torch.nn.init.normal_(parameter, std=0.1)
    image, told = torch.rand(2, 3, 64, 64), torch.randn(2, 22)
    assert torch.equal(network(image, told), plain(image)) and torch.equal(network(image), plain(image))
    network(image, told).square().sum().backward()
    assert network.maps.weighted.weight.grad.any(dim=(0, 2, 3)).all(), "every plane"
    torch.nn.init.normal_(network.maps.weighted.weight, std=0.1)
    assert not torch.allclose(network(image, told), network(image, -told))
    assert torch.equal(network(image), network(image, torch.zeros(2, 22)))
    # Told by its picture alone: no weights, but benches are its.
    assert by_picture.is_told and not plain.is_told and set(by_picture.state_dict()) == set(weights)
    assert torch.equal(by_picture(image, told), plain(image))


@pytest.mark.parametrize("numbers", [IDEAL, TILTED, NEAR], ids=["ideal", "tilted", "near"])
@pytest.mark.parametrize("which", range(8))
def test_maps_turn_with_the_plate_and_know_the_light(numbers, which):
    scene = bench(numbers)
    table, maps = ToldTable(SCENE), ToldMaps(SCENE, 4)
    values, known = told_of(scene, table)
    symmetry = all_symmetries(SCENE)[:, which : which + 1]
    planes = maps.planes(dropped(values, known, table))
    again = maps.planes(dropped(turned(values, symmetry, table), known, table))
    everywhere, tangent = planes[:, :-2], planes[:, -2:]
    assert (everywhere == everywhere[:, :, :1, :1]).all()
    assert torch.equal(everywhere[0, :, 0, 0], dropped(values, known, table)[0])
    # A vector's components turn besides the places where they are.
    mirror_x, mirror_y, swap = symmetry[:, 0]
    moved = transformed(tangent, symmetry)
    sign_x, sign_y = (-1.0 if mirror else 1.0 for mirror in (mirror_x, mirror_y))
    expected = torch.stack((sign_x * moved[0, 0], sign_y * moved[0, 1]))
    torch.testing.assert_close(again[0, -2:], expected.flip(0) if swap else expected, atol=1e-5, rtol=1e-5)
    # Along the way that light comes from the lamp to a sample of the plate's top.
    scale = table.scale[table.x]
    row, column = 5, 20
    place = [((k + 0.5) / 32 - 0.5) * size for k, size in zip((column, row), SCENE.plate_size_m, strict=True)]
    if scene.is_collimated:
        true = [math.tan(angle) for angle in scene.light_tilt_rad]
    else:
        lamp = scene.light_position_m
        height = lamp[2] - scene.base_thickness_m
        true = [(place[k] - lamp[k]) / height for k in (0, 1)]
    assert (scale * tangent[0, :, row, column]).tolist() == pytest.approx(true, abs=2e-6)


def test_ways_to_be_told_are_written_where_they_are_not_film(scene, configs):
    assert "told_by" not in architecture_record(configs[1]) and configs[1].told_by == "film"
    for way in ("maps", "picture"):
        record = architecture_record(told_by(configs, way))
        assert record["told_by"] == way and parse_architecture(record) == told_by(configs, way)
    with pytest.raises(ValueError, match="told_by is maps, but the network is told nothing"):
        DirectConfig(backbone=BACKBONE, told_by="maps")


@pytest.mark.parametrize("name", ["direct", "direct-family"])
def test_files_from_before_are_read_and_written_as_they_were(name):
    path = Path(nets.__path__[0]) / "trained" / f"{name}.safetensors"
    record, tensors, _ = decode(path.read_bytes(), name)
    loaded = load_weights(path)
    assert architecture_record(loaded.info.architecture) == record["architecture"]
    assert loaded.info.architecture.told_by == "film" and loaded.module.maps is None
    assert set(loaded.module.state_dict()) == {key for key in tensors if not key.endswith(STEP)}


def test_networks_that_are_told_nothing_are_as_before(scene, configs):
    assert not any("film" in name or "code" in name for name in build(configs[0], scene).state_dict())
    assert "conditions" not in architecture_record(configs[0])["backbone"]
    assert architecture_record(configs[1])["backbone"]["conditions"] == 11
    for config in configs:
        assert parse_architecture(architecture_record(config)) == config


def test_wrong_counts_are_refused(scene, configs):
    wrong = configs[1].backbone.model_copy(update={"conditions": 9})
    with pytest.raises(InputError, match="for 3 wavelengths there are 11 numbers to tell; set it to 11"):
        build(DirectConfig(backbone=wrong), scene)
    with pytest.raises(ValueError, match="only a direct network is told"):
        UnrolledConfig(backbone=configs[1].backbone)


@pytest.mark.parametrize("numbers", [{}, {"fresnel": True}, {"exit_medium": "glass"}])
@pytest.mark.parametrize("aside_m", [0.0, 0.02])
def test_closed_forms_and_calibration_know_the_same_light(numbers, aside_m):
    """A lamp at the nearest place that networks know, 5 degrees aside: they divide by what calibration divides by."""
    height = 0.25 + SCENE.base_thickness_m
    numbers = {"light_position_m": (aside_m, 0.0, height), "emission_half_angle_rad": 0.6, **numbers}
    scene = Scene.model_validate(SCENE.model_dump() | numbers)
    simulated_light = flat_light(scene, scene.image_pixels)
    table = ToldTable(scene)
    closed = FlatLight(table).level(table.centre[None])[0] * torch.tensor(scene.radiosity_W_m2)[:, None, None]
    assert simulated_light.amin() < 0.98 * simulated_light.amax()
    torch.testing.assert_close(closed.double(), simulated_light, rtol=1e-3, atol=0)
