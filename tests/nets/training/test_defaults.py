"""What a training does when nothing is set: as the paper trains its networks, and as this project trains its own."""

import torch

from nets.training.config import RunConfig, default_run
from nets.training.losses import total_variation
from nets.training.optimisation import WeightAverage
from nets.training.tasks import UpdaterTask

TAB_2_LAMBDA_TV = 9.81e-10
"""Weight of the total variation, best updater."""


def test_an_updater_pays_for_total_variation():
    """An answer without any error costs what its own variation costs (section 2.2 and Tab. 2)."""
    config = RunConfig.model_validate(default_run("updater"))
    task = UpdaterTask(config, torch.device("cpu"))
    truth = 1e-3 * torch.rand(2, 128, 128, generator=torch.Generator().manual_seed(0))
    images = torch.zeros(2, 3, 8, 8)
    batch = {"heights": truth, "start": truth, "gradient": truth, "target": images, "simulated": images}
    loss = task.loss(lambda target, simulated, start, gradient: start, batch, 0, 0.0)
    assert float(loss) > 0
    torch.testing.assert_close(loss, TAB_2_LAMBDA_TV * total_variation(truth))


def test_our_networks_are_averages_of_their_weights():
    """Weights that jump to and fro around zero: what is validated and exported is near zero."""
    for kind in ("direct", "unrolled"):
        training = default_run(kind)["training"]
        network = torch.nn.Linear(1, 1, bias=False)
        average = WeightAverage(network, training["ema_decay"])
        for step in range(4000):
            with torch.no_grad():
                network.weight.fill_((-1.0) ** step)
            average.update(step)
        assert abs(float(average.network.weight)) < 0.01
