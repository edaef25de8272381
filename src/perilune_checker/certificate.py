"""Form of a certificate: known words, names that mean one thing each, and nothing unused."""

import math
from itertools import pairwise
from typing import Any

from perilune_checker.expressions import require_claim

FORMAT = "perilune theorem 5"
KEYS = {  # of what a problem is stated by; `taken`, `text` and `digest` only say where it comes from
    "problem": {"name", "digest", "phases", "given", "free", "tapes"}, "tape": {"instructions", "outputs"},
    "phase": {"name", "duration", "states", "controls", "end", "path"}, "bounded": {"name", "lower", "upper"},
    "given": {"taken", "text", "number", "power_of_pi"}, "direction": {"kind", "names"},
    "control": {"kind", "names", "name", "lower", "upper"}, "arc": {"phase", "regimes", "switched"},
    "on": {"free", "ranges", "states"},
}  # fmt: skip


def unique_members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON, in which nothing stands twice."""
    found = dict(pairs)
    require_claim(len(found) == len(pairs), "something stands twice in it")
    return found


def require_form(told: dict[str, Any]) -> None:
    """Refuse what has another form."""
    require_claim(told["format"] == FORMAT, "it has another format")
    require_claim(type(told["bits"]) is int and 64 <= told["bits"] <= 2048, "it has no such number of bits")
    sizes = [*told["only_one_within"], *(weight for own in told["weights"] or () for weight in own)]
    require_claim(all(type(size) is float for size in sizes), "a size is no number")
    _require_problem_form(told["problem"])
    _require_sides_form(told["on_bounds"], told["problem"])
    phases, follows = told["problem"]["phases"], [arc["phase"] for arc in told["arcs"]]
    require_claim(follows == sorted(follows), "arcs are out of order")
    for i, (arc, grid) in enumerate(zip(told["arcs"], told["grid"], strict=True)):
        scalars = {c["name"] for c in phases[follows[i]]["controls"] if c["kind"] == "bounded"}
        require_claim({*arc} == KEYS["arc"], "something goes unread")
        require_claim({*arc["regimes"]} == scalars, "regimes are not those of the controls")
        require_claim({*arc["regimes"].values()} <= {"lower", "upper", "interior"}, "a control has no such regime")
        ends = follows[i : i + 2] == [follows[i]] * 2
        require_claim(bool(arc["switched"]) == ends, f"arc {i + 1} does not end where it says")
        require_claim(grid[0] == 0.0 and len(grid) < 10**4, f"the steps of arc {i + 1} do not begin where it does")
        rise = all(type(b) is float and a < b < math.inf for a, b in pairwise(grid))
        require_claim(rise, f"the steps of arc {i + 1} are out of order")


def _require_problem_form(problem: dict[str, Any]) -> None:
    keyed = [("problem", problem), *(("bounded", f) for f in problem["free"])]
    keyed += [(what, own) for what, of in (("given", "given"), ("tape", "tapes")) for own in problem[of].values()]
    names = [[*problem["given"], *(f["name"] for f in problem["free"])], [p["name"] for p in problem["phases"]]]
    tapes = {"objective", "start", *(f"links {k}" for k in range(len(problem["phases"]) - 1))}
    for k, p in enumerate(problem["phases"]):
        keyed += [("phase", p), *(("bounded", own) for what in ("states", "end") for own in p[what])]
        keyed += [("direction" if c["kind"] == "direction" else "control", c) for c in p["controls"]]
        names += [[own["name"] for own in p[what]] for what in ("states", "end")]
        names += [[name for c in p["controls"] for name in c["names"]], p["path"]]
        tapes |= {f"{what} {k}" for what in ("dynamics", "path", "end")}
        for what in ("path", "end"):
            count = len(problem["tapes"].get(f"{what} {k}", {"outputs": ()})["outputs"])
            require_claim(count == len(p[what]), f"{p['name']} does not name what its {what} states")
        require_claim(all(c["kind"] in ("direction", "bounded") for c in p["controls"]), "a control has no such kind")
        require_claim(
            all(c["kind"] == "direction" or c["names"] == [c["name"]] for c in p["controls"]), "a name is none"
        )
    require_claim(
        all({*own} <= KEYS[what] for what, own in keyed) and {*problem["tapes"]} <= tapes, "something goes unread"
    )
    for own in names:
        require_claim(len({*own}) == len(own), "two things have one name")
        require_claim(all(name[:1] != "-" and name.replace("-", "_").isidentifier() for name in own), "a name is none")


def _require_sides_form(on: dict[str, Any], problem: dict[str, Any]) -> None:
    places = {what: {(p["name"], own["name"]) for p in problem["phases"] for own in p[of]}
              for what, of in (("ranges", "end"), ("states", "states"))}  # fmt: skip
    require_claim({*on} == KEYS["on"], "something goes unread")
    require_claim({*on["free"]} <= {f["name"] for f in problem["free"]}, "a side is that of nothing")
    require_claim({*on["free"].values()} <= {"lower", "upper"}, "a bound has no such side")
    for what, known in places.items():
        own = [(p, n) for p, n, _ in on[what]]
        require_claim({*own} <= known and len({*own}) == len(own), "a side is that of nothing")
        sides = {"lower", "upper", "inside"} if what == "ranges" else {"lower", "upper"}
        require_claim({side for _, _, side in on[what]} <= sides, "a bound has no such side")
