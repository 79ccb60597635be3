"""Suite ``ideal``: the ten development fields on the bench that methods are told, as of ``nsfc compare --testset``."""

from data_gen.config import ReliefConfig
from data_gen.suites.case import Case, Plate, bench_plates
from data_gen.testset import DEVELOPMENT_FIELDS, fields_config

PLATES = DEVELOPMENT_FIELDS


def cases(count: int, seed: int | None = None) -> list[Case]:
    """The first ``count`` fields; with a seed of one's own, other plates of the same kind."""
    config = fields_config() if seed is None else bench_plates(seed, PLATES, ReliefConfig())
    title = "development fields, 1 % noise" if seed is None else "plates of another seed, 1 % noise"
    return [Case("ideal", "field", title, Plate(config, number), config.scene, config.scene) for number in range(count)]
