import pytest

from cli.config import load_config
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.units import length_m


@pytest.mark.parametrize(
    "text, metres",
    [
        ("3mm", 3e-3),
        ("50um", 50e-6),
        ("50 \N{MICRO SIGN}m", 50e-6),
        ("530nm", 530e-9),
        ("2.5cm", 0.025),
        ("-1e-3mm", -1e-6),
    ],
)
def test_a_length_is_the_number_that_metres_would_give(text, metres):
    assert length_m(text) == metres


@pytest.mark.parametrize("text", ["3", "3 parsec", "mm", "", "nanm", "1e9999mm", "--3mm"])
def test_other_text_is_no_length(text):
    assert length_m(text) is None


def test_units_wherever_a_key_is_in_metres(tmp_path):
    file = tmp_path / "x.yaml"
    file.write_text("scene:\n  base_thickness_m: 3mm\n  wavelengths_m: [610nm, 530nm, 430nm]\n")
    plain = load_config()
    written = load_config(str(file), ["scene.screen_position_m=[0, 0, -1um]", "reliefs.line_width_m=[0.1mm, 4mm]"])
    assert written == plain and written.fingerprint() == plain.fingerprint()
    assert Scene(plate_size_m=("5cm", 0.05)) == Scene()


def test_what_is_no_length_is_told_how_to_write_one():
    with pytest.raises(InputError, match="give metres, or a unit as in 3mm"):
        load_config(None, ["scene.base_thickness_m=3 parsec"])
