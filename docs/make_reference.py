"""Write the reference page of all keys, ``docs/reference.md``: ``python docs/make_reference.py``."""

from __future__ import annotations

from pathlib import Path

PAGE = Path(__file__).parent / "reference.md"

if __name__ == "__main__":
    from perilune.scenario.reference import reference

    PAGE.write_text(reference(), encoding="utf-8")
    print(PAGE.name)
