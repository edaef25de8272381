"""What the tests of the command line share: where the examples are, how a document is read."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
HYBRID = str(ROOT / "examples" / "hybrid_lander.toml")
ORDINARY = str(ROOT / "examples" / "ordinary_lander.toml")
COMMAND = [sys.executable, "-W", "error", "-m", "perilune"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "MPLBACKEND": "Agg"}


def no_constant(name: str) -> None:
    raise AssertionError(f"{name} in JSON")


def read_json(text: str) -> Any:
    """Exactly one document, without NaN."""
    return json.loads(text, parse_constant=no_constant)


def snapshot(directory: Path) -> dict[str, bytes]:
    """Every file below a directory."""
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}
