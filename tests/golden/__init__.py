"""The golden file: what the program answers today, so that a change meant to alter no answer can be held to that.

One JSON file for each part, beside this module. Numbers are written as Python writes them, so every bit comes back.
``python tests/make_golden.py`` makes the files anew, and with ``--compare`` finds the last bit that differs from them;
``tests/test_golden.py`` asks of every machine only what does not hang on its libraries.
"""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent
PARTS = ("answers", "proofs", "theorems", "sweep", "atlases", "commands")
