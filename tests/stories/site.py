"""Checks that no page of a built site loads from another host, and that all fences became code.

python tests/stories/site.py target/site
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path

LOADED = {"script": "src", "img": "src", "iframe": "src", "link": "href", "source": "src"}


class Loads(HTMLParser):
    """Collects the addresses that a page loads without a click."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what this element loads."""
        address = dict(attrs).get(LOADED.get(tag, ""))
        if address is not None:
            self.addresses.append(address)


def foreign(page: Path) -> list[str]:
    """Return the addresses on other hosts that the page loads."""
    parser = Loads()
    parser.feed(page.read_text(encoding="utf-8"))
    return [a for a in parser.addresses if a.startswith(("http:", "https:", "//"))]


def main(site: Path) -> None:
    """Check every page of the site."""
    pages = sorted(site.rglob("*.html"))
    styles = sorted(site.rglob("*.css"))
    found = {str(page): addresses for page in pages if (addresses := foreign(page))}
    found |= {str(page): ["```"] for page in pages if "```" in page.read_text(encoding="utf-8")}
    found |= {str(s): ["url(http"] for s in styles if "url(http" in s.read_text(encoding="utf-8")}
    if found or not pages:
        sys.exit(
            f"{len(pages)} pages in {site}; loaded from other hosts, or left of fences: {found}"
        )
    print(f"{len(pages)} pages, nothing from other hosts")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
