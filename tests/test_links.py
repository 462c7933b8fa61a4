"""Every link of README and documents leads somewhere: page, picture, and heading."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
#: What the site's builder writes is not ours.
BUILT = {"_build", "built", "generated"}
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *(p for p in sorted(DOCS.rglob("*.md")) if not BUILT & set(p.relative_to(DOCS).parts)),
]
LINK = re.compile(r"\]\((?![a-z]+:)([^)\s]*)\)")
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)


def test_there_are_pages_to_look_at() -> None:
    assert len(PAGES) > 20


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    assert [link for link in links_of(page) if not leads_somewhere(page, link)] == []


def test_every_picture_is_shown_somewhere() -> None:
    shown = {(page.parent / link).resolve() for page in PAGES for link in links_of(page)}
    pictures = {path.resolve() for path in (DOCS / "pictures").iterdir() if path.is_file()}
    assert sorted(path.name for path in pictures - shown) == []


def test_a_wrong_page_and_a_wrong_heading_are_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A title: T/A, *now*\n\n```\n# no title\n```\n\n## A title: T/A, *now*\n")
    for link in ("page.md", "#a-title-ta-now", "page.md#a-title-ta-now-1"):
        assert leads_somewhere(page, link)
    for link in ("other.md", "#no-title", "page.md#a-title-ta-now-2"):
        assert not leads_somewhere(page, link)


def links_of(page: Path) -> list[str]:
    """Return the relative links and pictures of a page."""
    return LINK.findall(FENCED.sub("", page.read_text(encoding="utf-8")))


def leads_somewhere(page: Path, link: str) -> bool:
    """Say whether a file exists, and the heading in it that a link names."""
    path, _, heading = link.partition("#")
    target = (page.parent / path) if path else page
    if not target.exists():
        return False
    return not heading or heading in headings_of(target)


def headings_of(page: Path) -> set[str]:
    """Return what a page's headings are called in links, as GitHub and MyST do it."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    seen: Counter[str] = Counter()
    names = set()
    for title in re.findall(r"^#{1,6} +(.+?) *$", text, re.MULTILINE):
        name = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        names.add(f"{name}-{seen[name]}" if seen[name] else name)
        seen[name] += 1
    return names
