"""Which format a file has: its first bytes decide, not its suffix."""

import codecs
from pathlib import Path

from warp_caustics.errors import InputError
from warp_caustics.io.regular import open_regular

SUFFIXES = {
    ".png": "png",
    ".tif": "tiff",
    ".tiff": "tiff",
    ".exr": "exr",
    ".npy": "npy",
    ".npz": "npz",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
}
_READ_SUFFIXES = {**SUFFIXES, ".jpg": "jpeg", ".jpeg": "jpeg"}
_MAGIC = {
    b"\x89PNG\r\n\x1a\n": "png",
    b"II*\0": "tiff",
    b"MM\0*": "tiff",
    b"II+\0": "tiff",
    b"MM\0+": "tiff",
    b"\x76\x2f\x31\x01": "exr",
    b"\x93NUMPY": "npy",
    b"PK\x03\x04": "npz",
    b"PK\x05\x06": "npz",
    b"\x89HDF\r\n\x1a\n": "hdf5",
    b"\xff\xd8\xff": "jpeg",
}
_REFUSED_MAGIC = {
    b"GIF8": "GIF, which has a palette of 256 colours",
    b"BM": "BMP, which has 8 bits",
    b"RIFF": "WebP, which is 8-bit and mostly lossy",
    b"\0\0\0\x0cjP": "JPEG 2000, which is mostly lossy",
    b"\xff\x0a": "JPEG XL, which is mostly lossy",
    b"%PDF": "a PDF",
    b"FUJIFILM": "a raw camera file",
    b"IIRO": "a raw camera file",
    b"IIU\0": "a raw camera file",
}


def _is_text(head: bytes) -> bool:
    try:
        # Incremental, because the head may end within a character.
        text = codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(character.isprintable() or character.isspace() for character in text)


INSTEAD_OF_IMAGE = "export a linear 16-bit TIFF or PNG, or give EXR, NPY, NPZ or HDF5"


def sniff_format(path: Path, instead: str = INSTEAD_OF_IMAGE) -> tuple[str, list[str]]:
    """Format by the first bytes of a file, and a note where its suffix claims another.

    Args:
        path: of a regular file.
        instead: what to give where the content is refused.

    Raises:
        InputError: the content is no format that keeps all bits.
    """
    with open_regular(path) as stream:
        head = stream.read(512)
    name = repr(str(path))
    if head.startswith((b"II*\0", b"MM\0*")) and head[8:10] == b"CR":
        raise InputError(f"{name} is a raw camera file (CR2); {instead}")
    for magic, format_ in _MAGIC.items():
        if head.startswith(magic):
            claimed = _READ_SUFFIXES.get(path.suffix.lower(), format_)
            wrong = f"{name} holds {format_} data in spite of its suffix; read as {format_}, rename it"
            return format_, [] if claimed == format_ else [wrong]
    refused = next((text for magic, text in _REFUSED_MAGIC.items() if head.startswith(magic)), None)
    if head[4:8] == b"ftyp":
        refused = "HEIC, AVIF or a raw camera file"
    if refused is None:
        refused = "text" if _is_text(head) else "in none of the known formats"
    raise InputError(f"{name} is {refused}; {instead}")
