"""Static files of the page, as they lie in the package."""

from __future__ import annotations

from importlib.resources import files


def page_files() -> dict[str, bytes]:
    """Return all files of the page, by name."""
    found, left = dict[str, bytes](), [("", files("perilune.app") / "page")]
    while left:
        before, folder = left.pop()
        for entry in folder.iterdir():
            if entry.is_dir():
                left.append((f"{before}{entry.name}/", entry))
            else:
                found[before + entry.name] = entry.read_bytes()
    return found
