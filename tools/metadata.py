"""What the package says of itself where it is published: its address, and links that are whole.

The address is one line of pyproject.toml, ``[tool.hatch.metadata.hooks.custom] address``. While it
is empty, there are no links to project pages, and README's links are those of its folder.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

try:
    from hatchling.metadata.plugin.interface import MetadataHookInterface
except ImportError:  # where it is only read, as by the tests
    MetadataHookInterface = object

#: Where a link or the address of a picture begins, in Markdown or HTML, unless it is whole.
LINK = re.compile(r"(\]\(|src=\"|href=\")(?!https?:|#|mailto:)([^)\"\s]+)")
PICTURES = (".png", ".gif", ".svg", ".jpg")


class Published(MetadataHookInterface):  # type: ignore[misc, valid-type]
    """Fills in what depends on the address."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set README and the links to the project's pages."""
        address = str(self.config.get("address", "")).rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": with_whole_links(text, address) if address else text,
        }
        metadata["urls"] = pages(address) if address else {}


def pages(address: str) -> dict[str, str]:
    """Return the project's pages."""
    return {
        "Homepage": address,
        "Documentation": f"{address}/tree/main/docs",
        "Issues": f"{address}/issues",
        "Changes": f"{address}/blob/main/CHANGELOG.md",
    }


def with_whole_links(text: str, address: str) -> str:
    """Return a text whose links to files of the project are whole.

    Examples
    --------
    >>> with_whole_links("[limits](docs/limits.md) ![](a.png)", "https://a.b/c")
    '[limits](https://a.b/c/blob/main/docs/limits.md) ![](https://a.b/c/raw/main/a.png)'
    """

    def whole(match: re.Match[str]) -> str:
        kind = "raw" if match[2].lower().endswith(PICTURES) else "blob"
        return f"{match[1]}{address}/{kind}/main/{match[2]}"

    return LINK.sub(whole, text)
