"""Names of files as text: a name on disk is bytes, which need not be text."""


def printable(name: str) -> str:
    r"""A name that can be written anywhere; bytes that are no UTF-8 are spelled ``\udcff``, others stay."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")
