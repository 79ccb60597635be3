"""Suite ``ideal``: the ten development fields on the bench that methods are told, as of ``nsfc compare --testset``."""

from data_gen.suites.case import Case, Plate
from data_gen.testset import DEVELOPMENT_FIELDS, fields_config

PLATES = DEVELOPMENT_FIELDS


def cases(count: int) -> list[Case]:
    """The first ``count`` fields."""
    config = fields_config()
    title = "development fields, 1 % noise"
    return [Case("ideal", "field", title, Plate(config, number), config.scene, config.scene) for number in range(count)]
