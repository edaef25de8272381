"""Make the golden file of this machine anew, or compare what the program answers now with it, bit for bit.

    python tests/make_golden.py                      all of tests/golden/*.json
    python tests/make_golden.py --compare            exit 1, and every difference, if any bit is another
    python tests/make_golden.py --to DIR             the same elsewhere; --compare --to DIR
    python tests/make_golden.py [...] answers proofs only these parts

Another processor, BLAS or libm gives other last bits: there make it at the commit before a change, elsewhere (--to),
and compare with that after it. It takes about three minutes of one core.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # the order of sums is then the same; before NumPy is loaded
os.environ["MPLBACKEND"] = "Agg"
SHOWN = 40  # differences of a part


def records_of(part: str, quick: bool = False) -> dict[str, Any]:
    """Return the records of one part, as JSON gives them back."""
    from golden.answers import answer_records, proof_records, sweep_records, theorem_records
    from golden.atlases import query_records
    from golden.commands import command_records

    makers = {
        "answers": answer_records, "proofs": proof_records, "theorems": theorem_records, "sweep": sweep_records,
        "atlases": query_records, "commands": command_records,
    }  # fmt: skip
    return json.loads(json.dumps(makers[part](quick)))


def write_records(records: dict[str, Any], path: Path) -> None:
    """Write records, a line each."""
    lines = (f"{json.dumps(name)}: {json.dumps(record, ensure_ascii=False)}" for name, record in records.items())
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def main() -> int:
    """Make or compare; the exit code."""
    from golden import FOLDER, PARTS
    from golden.compare import record_differences

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--compare", action="store_true", help="write nothing; say what differs")
    parser.add_argument("--to", type=Path, default=FOLDER, metavar="DIR", help="where the files are")
    options = parser.parse_args()
    gc.set_threshold(50_000)
    options.to.mkdir(parents=True, exist_ok=True)
    found = 0
    for part in options.parts or PARTS:
        now, path = records_of(part), options.to / f"{part}.json"
        if not options.compare:
            write_records(now, path)
            print(f"{path}: {len(now)} records", flush=True)
            continue
        kinds = list(record_differences(json.loads(path.read_text(encoding="utf-8")), now, exact=True))
        found += len(kinds)
        count = {kind: sum(one.kind == kind for one in kinds) for kind in sorted({one.kind for one in kinds})}
        print(f"{part}: {', '.join(f'{n} of {kind}' for kind, n in count.items()) or 'equal'}", flush=True)
        print(*(f"  {one}" for one in kinds[:SHOWN]), sep="\n", end="\n" if kinds else "", flush=True)
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
