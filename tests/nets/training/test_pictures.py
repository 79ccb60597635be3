"""Pictures of fewer wavelengths or pixels that networks see in training."""

import pydantic
import pytest
import torch

from nets.symmetries import all_symmetries
from nets.training.camera import draw_cameras, seen
from nets.training.config import RunConfig
from nets.training.pictures import PictureMaker
from nets.training.sources import make_source
from nets.training.told_task import ToldTask
from warp_caustics.resampling import regridded

CPU = torch.device("cpu")
OFF = {"one_wavelength_share": 0.0, "two_wavelengths_share": 0.0, "coarse_share": 0.0}


@pytest.fixture
def task(told_run):
    """Of a run whose pictures are as wished."""

    def make(**pictures):
        # Without mixing, in which the other channels' places show a little.
        config = told_run(batch_size=6, pictures={**OFF, **pictures}, camera={"mixing": 0.0})
        return ToldTask(config, CPU)

    return make


@pytest.fixture
def batch(told_run):
    source = make_source(told_run(batch_size=6), CPU)
    found = source.batch(0)
    source.close()
    return found


class Shown(torch.nn.Module):
    """Remembers what it was shown."""

    def forward(self, image, told):
        self.image, self.told = image, told
        return torch.zeros(len(image), 16, 16, requires_grad=True)


def shown(task, batch, step=3):
    model = Shown()
    task.loss(model, batch, step, 0.0)
    return model


def test_other_draws_stay_as_they_were(task, batch):
    """Shares too small to be met change no picture and no number: they are drawn by themselves."""
    plain, rare = (shown(task(**pictures), batch) for pictures in ({}, {"one_wavelength_share": 1e-12}))
    assert torch.equal(plain.image, rare.image) and torch.equal(plain.told, rare.told)
    assert task().pictures.drawn(6, torch.Generator()) is None


def test_one_wavelength_is_in_all_channels_with_its_noise(task, batch):
    plain, one = shown(task(), batch), shown(task(one_wavelength_share=1.0), batch)
    assert torch.equal(one.image, plain.image[:, 1:2].expand(-1, 3, -1, -1))
    places = [task().table.place(f"dispersion_{k}") for k in (0, 2)]
    centre, scale = task().table.centre[places], task().table.scale[places]
    known = one.told[:, [11 + place for place in places]]
    assert torch.allclose(one.told[:, places], -centre / scale * known) and known.any()
    # The others are told as before, but for the blur, which is now that of one channel.
    same = [place for place in range(22) if place not in (*places, 9)]
    assert torch.equal(one.told[:, same], plain.told[:, same])


def test_of_two_wavelengths_one_is_lost(task, batch):
    two = task(two_wavelengths_share=1.0).pictures
    drawn = two.drawn(400, torch.Generator().manual_seed(1))
    assert (drawn.missing.sum(dim=1) == 1).all() and not drawn.missing[:, 1].any()
    assert 150 < drawn.missing[:, 0].sum() < 250
    values = two.bench(batch["bench"], two.drawn(6, torch.Generator().manual_seed(2)))
    assert ((values == 0) & (batch["bench"] != 0)).sum(dim=1).tolist() == [1] * 6


def test_shares_are_met(task):
    maker = task(one_wavelength_share=0.2, two_wavelengths_share=0.3, coarse_share=0.4).pictures
    drawn = maker.drawn(20_000, torch.Generator().manual_seed(0))
    lost = drawn.missing.sum(dim=1)
    assert (lost == 2).float().mean() == pytest.approx(0.2, abs=0.01)
    assert (lost == 1).float().mean() == pytest.approx(0.3, abs=0.01)
    assert drawn.is_coarse.float().mean() == pytest.approx(0.4, abs=0.01)


def test_a_coarse_picture_is_what_a_reconstruction_makes_of_fewer_pixels(task, batch):
    """The noise is that of the fewer pixels, as it is told."""
    coarse = task(coarse_share=1.0)
    images = torch.ones(64, 3, 64, 64)
    maker = PictureMaker(coarse.training.pictures, coarse.table, coarse.flat)
    pictures = maker.fixed(64, is_coarse=True)
    options = coarse.training.camera.model_copy(update={"clean_share": 1.0, "exposure": 0.0})
    camera = draw_cameras(options, 64, 3, torch.Generator().manual_seed(3))
    camera = camera._replace(noise=torch.full((64,), 0.02))
    noisy = seen(images, coarse.flat, maker.noises(camera, pictures), torch.Generator().manual_seed(4))
    found = maker.seen(noisy, pictures)
    few = torch.nn.functional.avg_pool2d(noisy, 2)
    assert few.std() == pytest.approx(0.02, rel=0.02)
    assert (found - regridded(few, 64)).abs().max() < 1e-5
    sharp, soft = shown(task(), batch), shown(coarse, batch)
    assert torch.equal(sharp.told, soft.told) and not torch.equal(sharp.image, soft.image)


def test_pictures_turn_with_their_plates(task, batch):
    """Coarse pictures have the symmetries of the square."""
    maker = task(coarse_share=1.0).pictures
    pictures = maker.fixed(6, is_coarse=True)
    for mirror_x, mirror_y, swap in all_symmetries(task().config.scene).T.tolist():

        def turned(images, mirror_x=mirror_x, mirror_y=mirror_y, swap=swap):
            images = images.flip(-1) if mirror_x else images
            images = images.flip(-2) if mirror_y else images
            return images.transpose(-1, -2) if swap else images

        first, then = maker.seen(turned(batch["image"]), pictures), turned(maker.seen(batch["image"], pictures))
        assert (first - then).abs().max() < 1e-5 * batch["image"].max()


def test_a_run_judges_such_pictures_by_themselves(told_run, train, tmp_path):
    config = told_run(total_steps=1, steps_per_epoch=1, pictures={"one_wavelength_share": 0.5, "coarse_share": 0.5})
    found = train(config, tmp_path / "run").validation
    assert found["val_one_wavelength_rmse_um"] > 0 and found["val_coarse_rmse_um"] > 0
    without = train(told_run(total_steps=1, steps_per_epoch=1, pictures=OFF), tmp_path / "without").validation
    assert not without.keys() & {"val_one_wavelength_rmse_um", "val_coarse_rmse_um"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"one_wavelength_share": 0.7, "two_wavelengths_share": 0.6}, "are more than 1 together"),
        ({"coarse_share": 0.5, "coarse_binning": 5}, "coarse_binning 5 does not divide 64 image pixels"),
    ],
)
def test_pictures_that_cannot_be_are_refused(told_run, changes, message):
    tree = told_run().model_dump(mode="json")
    tree["training"]["pictures"] = changes
    with pytest.raises(pydantic.ValidationError, match=message):
        RunConfig.model_validate(tree)


def test_networks_that_are_told_nothing_have_no_such_pictures(tiny_run):
    with pytest.raises(pydantic.ValidationError, match=r"training\.pictures is for networks that are told"):
        tiny_run("direct", pictures={"coarse_share": 0.1})
