"""Caustics of printed glass plates: simulation, exact gradients, reconstruction.

These names are the public ones, imported on first use. Methods by name, those
without networks too, are made by :func:`nets.create`.
"""

from typing import TYPE_CHECKING

from warp_caustics.front_door import front_door

if TYPE_CHECKING:
    from warp_caustics.camera.config import CameraConfig as CameraConfig
    from warp_caustics.camera.config import SensorConfig as SensorConfig
    from warp_caustics.camera.config import read_camera as read_camera
    from warp_caustics.camera.exposure import exposed as exposed
    from warp_caustics.camera.operator import Camera as Camera
    from warp_caustics.camera.parameters import CameraParameters as CameraParameters
    from warp_caustics.camera.photographs import Photographs as Photographs
    from warp_caustics.camera.photographs import photographs as photographs
    from warp_caustics.design.designer import Designer as Designer
    from warp_caustics.errors import CausticsError as CausticsError
    from warp_caustics.errors import DamagedDataError as DamagedDataError
    from warp_caustics.errors import InputError as InputError
    from warp_caustics.errors import MismatchError as MismatchError
    from warp_caustics.errors import ResourceError as ResourceError
    from warp_caustics.inspection.judge import judge_plate as judge_plate
    from warp_caustics.inspection.nominal import Nominal as Nominal
    from warp_caustics.io.heights import read_heights as read_heights
    from warp_caustics.io.heights import write_heights as write_heights
    from warp_caustics.io.images import read_image as read_image
    from warp_caustics.io.images import write_image as write_image
    from warp_caustics.metrics import height_errors as height_errors
    from warp_caustics.prints.design_file import design_relief as design_relief
    from warp_caustics.prints.design_file import read_design as read_design
    from warp_caustics.prints.line import Line as Line
    from warp_caustics.prints.line import line_relief as line_relief
    from warp_caustics.prints.line_list import read_lines as read_lines
    from warp_caustics.prints.line_list import write_lines as write_lines
    from warp_caustics.reconstruct.base import CausticImage as CausticImage
    from warp_caustics.reconstruct.base import Reconstruction as Reconstruction
    from warp_caustics.scene import Scene as Scene
    from warp_caustics.setup.information import fisher_information as fisher_information
    from warp_caustics.setup.knowledge import knowledge as knowledge
    from warp_caustics.setup.model import SetUpModel as SetUpModel
    from warp_caustics.setup.set_up import SetUp as SetUp
    from warp_caustics.simulator import CausticSimulator as CausticSimulator

_HOMES = {
    "Camera": "warp_caustics.camera.operator",
    "CameraConfig": "warp_caustics.camera.config",
    "CameraParameters": "warp_caustics.camera.parameters",
    "CausticImage": "warp_caustics.reconstruct.base",
    "CausticSimulator": "warp_caustics.simulator",
    "CausticsError": "warp_caustics.errors",
    "DamagedDataError": "warp_caustics.errors",
    "Designer": "warp_caustics.design.designer",
    "InputError": "warp_caustics.errors",
    "Line": "warp_caustics.prints.line",
    "MismatchError": "warp_caustics.errors",
    "Nominal": "warp_caustics.inspection.nominal",
    "Photographs": "warp_caustics.camera.photographs",
    "Reconstruction": "warp_caustics.reconstruct.base",
    "ResourceError": "warp_caustics.errors",
    "Scene": "warp_caustics.scene",
    "SensorConfig": "warp_caustics.camera.config",
    "SetUp": "warp_caustics.setup.set_up",
    "SetUpModel": "warp_caustics.setup.model",
    "design_relief": "warp_caustics.prints.design_file",
    "exposed": "warp_caustics.camera.exposure",
    "fisher_information": "warp_caustics.setup.information",
    "height_errors": "warp_caustics.metrics",
    "judge_plate": "warp_caustics.inspection.judge",
    "knowledge": "warp_caustics.setup.knowledge",
    "line_relief": "warp_caustics.prints.line",
    "photographs": "warp_caustics.camera.photographs",
    "read_camera": "warp_caustics.camera.config",
    "read_design": "warp_caustics.prints.design_file",
    "read_heights": "warp_caustics.io.heights",
    "read_image": "warp_caustics.io.images",
    "read_lines": "warp_caustics.prints.line_list",
    "write_heights": "warp_caustics.io.heights",
    "write_image": "warp_caustics.io.images",
    "write_lines": "warp_caustics.prints.line_list",
}

__all__ = [*_HOMES]

__getattr__ = front_door(__name__, _HOMES)
