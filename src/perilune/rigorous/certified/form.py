"""Form of a certificate: known words, names that mean one thing each, and nothing that nobody reads."""

import math
from itertools import pairwise
from typing import Any

from perilune.rigorous.certified.expressions import demand

FORMAT = "perilune theorem 5"
KEYS = {  # of what a problem is stated by; `taken`, `text` and `digest` only say where it comes from
    "problem": {"name", "digest", "phases", "given", "free", "tapes"}, "tape": {"instructions", "outputs"},
    "phase": {"name", "duration", "states", "controls", "end", "path"}, "bounded": {"name", "lower", "upper"},
    "given": {"taken", "text", "number", "power_of_pi"}, "direction": {"kind", "names"},
    "control": {"kind", "names", "name", "lower", "upper"}, "arc": {"phase", "regimes", "switched"},
    "on": {"free", "ranges", "states"},
}  # fmt: skip


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON, in which nothing stands twice."""
    found = dict(pairs)
    demand(len(found) == len(pairs), "something stands twice in it")
    return found


def well_formed(told: dict[str, Any]) -> None:
    """Refuse what has another form."""
    demand(told["format"] == FORMAT, "it has another format")
    demand(type(told["bits"]) is int and 64 <= told["bits"] <= 2048, "it has no such number of bits")
    sizes = [*told["only_one_within"], *(weight for own in told["weights"] or () for weight in own)]
    demand(all(type(size) is float for size in sizes), "a size is no number")
    _problem_formed(told["problem"])
    _sides_formed(told["on_bounds"], told["problem"])
    phases, follows = told["problem"]["phases"], [arc["phase"] for arc in told["arcs"]]
    demand(follows == sorted(follows), "arcs are out of order")
    for i, (arc, grid) in enumerate(zip(told["arcs"], told["grid"], strict=True)):
        scalars = {c["name"] for c in phases[follows[i]]["controls"] if c["kind"] == "bounded"}
        demand({*arc} == KEYS["arc"], "something goes unread")
        demand({*arc["regimes"]} == scalars, "regimes are not those of the controls")
        demand({*arc["regimes"].values()} <= {"lower", "upper", "interior"}, "a control has no such regime")
        ends = follows[i : i + 2] == [follows[i]] * 2
        demand(bool(arc["switched"]) == ends, f"arc {i + 1} does not end where it says")
        demand(grid[0] == 0.0 and len(grid) < 10**4, f"the steps of arc {i + 1} do not begin where it does")
        rise = all(type(b) is float and a < b < math.inf for a, b in pairwise(grid))
        demand(rise, f"the steps of arc {i + 1} are out of order")


def _problem_formed(problem: dict[str, Any]) -> None:
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
            demand(count == len(p[what]), f"{p['name']} does not name what its {what} states")
        demand(all(c["kind"] in ("direction", "bounded") for c in p["controls"]), "a control has no such kind")
        demand(all(c["kind"] == "direction" or c["names"] == [c["name"]] for c in p["controls"]), "a name is none")
    demand(all({*own} <= KEYS[what] for what, own in keyed) and {*problem["tapes"]} <= tapes, "something goes unread")
    for own in names:
        demand(len({*own}) == len(own), "two things have one name")
        demand(all(name[:1] != "-" and name.replace("-", "_").isidentifier() for name in own), "a name is none")


def _sides_formed(on: dict[str, Any], problem: dict[str, Any]) -> None:
    places = {what: {(p["name"], own["name"]) for p in problem["phases"] for own in p[of]}
              for what, of in (("ranges", "end"), ("states", "states"))}  # fmt: skip
    demand({*on} == KEYS["on"], "something goes unread")
    demand({*on["free"]} <= {f["name"] for f in problem["free"]}, "a side is that of nothing")
    demand({*on["free"].values()} <= {"lower", "upper"}, "a bound has no such side")
    for what, known in places.items():
        own = [(p, n) for p, n, _ in on[what]]
        demand({*own} <= known and len({*own}) == len(own), "a side is that of nothing")
        sides = {"lower", "upper", "inside"} if what == "ranges" else {"lower", "upper"}
        demand({side for _, _, side in on[what]} <= sides, "a bound has no such side")
