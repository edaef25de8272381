"""Lanes into vectors and back, as LLVM IR: a group gathers arcs, ended lanes are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.kernels.flight.arcs import INFO

if TYPE_CHECKING:
    from perilune.kernels.flight.driver import Driver


def gather(d: Driver, group: str) -> None:
    """Fetch the lanes of a group; places beyond the batch repeat its last lane and are not active."""
    w, t = d.w, d.table
    first = w.let(f"mul i64 {group}, {d.width}")
    with w.loop(0, d.width) as k:
        place = w.let(f"add i64 {first}, {k}")
        inside = w.let(f"icmp slt i64 {place}, {t['lanes']}")
        final = w.let(f"sub i64 {t['lanes']}, 1")
        lane = w.load(t["order"], w.let(f"select i1 {inside}, i64 {place}, i64 {final}"), "i64")
        w.store(lane, d.lane, k, "i64")
        _copy_in(d, t["z0"], w.let(f"mul i64 {lane}, {d.nz}"), d.state, d.nz, k)
        _copy_in(d, t["p"], w.let(f"mul i64 {lane}, {t['p_stride']}"), d.parameters, d.system.np, k)
        base = w.let(f"mul i64 {lane}, {d.nz * d.system.nc}")
        with w.loop(0, d.n - d.nz) as c:
            source = w.let(f"add i64 {base}, {w.load('@offsets', c, 'i64')}")
            value = w.load(t["seeds"], source, "double")
            w.store(value, d.state, element(d, w.let(f"add i64 {c}, {d.nz}"), k), "double")
        for number, name in enumerate(("duration", "rtol", "atol", "mode")):
            value = w.load(t[name], lane, "double")
            w.store(value, d.element, element(d, str(number), k), "double")
        alive = w.let(f"uitofp i1 {inside} to double")
        w.store(alive, d.element, element(d, "4", k), "double")
    for number, name in enumerate(("duration", "rtol", "atol", "mode")):
        w.store(w.load(d.element, number), getattr(d, name))
    w.store(w.compare("ogt", w.load(d.element, 4), w.const(0.0)), d.active, kind=w.mask)
    for name in ("time", "refused", "steps", "tries", "status", "events"):
        w.store(w.const(0.0), getattr(d, name))


def element(d: Driver, vector: str, lane: str) -> str:
    """Return the index of a lane of a vector, counted in doubles."""
    w = d.w
    return w.let(f"add i64 {w.let(f'mul i64 {vector}, {d.width}')}, {lane}")


def _copy_in(d: Driver, source: str, base: str, target: str, count: int, lane: str) -> None:
    w = d.w
    with w.loop(0, count) as c:
        value = w.load(source, w.let(f"add i64 {base}, {c}"), "double")
        w.store(value, target, element(d, c, lane), "double")


def write_out(d: Driver, ended: str) -> None:
    """Write state, rates, columns and report of the lanes that have ended: the first slopes are those of the state."""
    w, t = d.w, d.table
    for number, name in enumerate(INFO):
        w.store(w.load(getattr(d, name)), d.element, number)
    w.store(w.select(ended, w.const(1.0), w.const(0.0)), d.element, len(INFO))
    with w.loop(0, d.width) as k:
        flag = w.load(d.element, element(d, str(len(INFO)), k), "double")
        with w.when(w.let(f"fcmp ogt double {flag}, 0.0")):
            lane = w.load(d.lane, k, "i64")
            _copy_out(d, d.state, t["z"], w.let(f"mul i64 {lane}, {d.nz}"), d.nz, k)
            _copy_out(d, d.slopes, t["rates"], w.let(f"mul i64 {lane}, {d.nz}"), d.nz, k)
            base = w.let(f"mul i64 {lane}, {d.nz * d.system.nc}")
            with w.loop(0, d.n - d.nz) as c:
                value = w.load(d.state, element(d, w.let(f"add i64 {c}, {d.nz}"), k), "double")
                target = w.let(f"add i64 {base}, {w.load('@offsets', c, 'i64')}")
                w.store(value, t["columns"], target, "double")
            _copy_out(d, d.element, t["info"], w.let(f"mul i64 {lane}, {len(INFO)}"), len(INFO), k)


def _copy_out(d: Driver, source: str, target: str, base: str, count: int, lane: str) -> None:
    w = d.w
    with w.loop(0, count) as c:
        value = w.load(source, element(d, c, lane), "double")
        w.store(value, target, w.let(f"add i64 {base}, {c}"), "double")
