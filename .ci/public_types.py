"""Whether every name that `import perilune` offers has a full type, and how many of all symbols have one.

Of modules that it offers, every public name in them and below. Prints what is missing; exit code 1 if anything is.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator

import perilune as pl
from perilune.core.facade import face_imports


def offered() -> Iterator[str]:
    """Dotted names of everything that is public, at the package and where it is defined."""
    for name in pl.__all__:
        yield f"perilune.{name}"
        home, own = face_imports("perilune")[name]
        yield f"{home}.{own}"


def main() -> int:
    """Ask pyright."""
    asked = ["pyright", "--verifytypes", "perilune", "--ignoreexternal", "--outputjson"]
    found = json.loads(subprocess.run(asked, capture_output=True, text=True).stdout)["typeCompleteness"]
    public = tuple(offered())
    missing, total = set(), 0
    for symbol in found["symbols"]:
        name = symbol["name"]
        if not symbol["isExported"] or not any(name == p or name.startswith(f"{p}.") for p in public):
            continue
        total += 1
        if not symbol["isTypeKnown"] or symbol["isTypeAmbiguous"]:
            missing.add(name)
    for name in sorted(missing):
        print(f"no full type: {name}")
    print(f"{total - len(missing)} of {total} public symbols have a full type, {found['completenessScore']:.1%} of all")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
