"""Links lead somewhere, every page is reached, and none tells of a machine."""

import re

import pytest

from tests.docs.pages import DOCS, FENCE, PAGES, ROOT


def anchors(page):
    """Anchors of a page's headings, as GitHub and MyST name them."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_images_exist(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if target == DOCS / "gallery" / "index.rst":
            target = ROOT / "examples" / "gallery" / "GALLERY_HEADER.rst"
        assert target.is_file(), link
        if anchor:
            assert anchor in anchors(target), link


def test_plain_text_names_no_page():
    """A page is linked, not named: (docs/x.md) leads nowhere on the built pages."""
    for page in PAGES:
        unlinked = re.sub(r"\[[^\]]*\]\([^)]*\)", "", page.read_text(encoding="utf-8"))
        assert not re.findall(r"\(docs/\w+\.md\)", unlinked), page


def test_every_page_is_in_a_table_of_contents():
    reachable, waiting = set(), [DOCS / "index.md"]
    while waiting:
        page = waiting.pop()
        if page in reachable:
            continue
        reachable.add(page)
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
            for entry in re.findall(r"^(?!:)(?:.* <)?([\w/-]+)>?$", tree, re.M):
                if entry != "gallery/index":
                    waiting.append(page.parent / f"{entry}.md")
    assert {page for page in PAGES if DOCS in page.parents} == reachable


def test_no_page_is_called_like_a_page_of_sphinx():
    """search.md would be overwritten by the page of the search field."""
    assert not {"search", "genindex", "py-modindex"} & {page.stem for page in DOCS.glob("*.md")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_machine_is_named(page):
    assert not re.findall(r"(?<![\w.])/(?:work|root|home|tmp|mnt|opt)/", page.read_text(encoding="utf-8"))


def test_links_to_the_world_are_known():
    """An address that nobody looked at may not exist."""
    known = ("https://github.com/NVIDIA/warp", "https://plotly.com/javascript/")
    for page in PAGES:
        found = re.findall(r"\]\((https?:[^)\s]+)\)", page.read_text(encoding="utf-8"))
        assert set(found) <= set(known), page
