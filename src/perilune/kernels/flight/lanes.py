"""Gathering of arcs into vectors of lanes and writing of ended lanes, as LLVM IR."""

from __future__ import annotations

from perilune.kernels.code.ir import INT, NUM, Index, Int, Mask, Num, Ptr, Vec
from perilune.kernels.flight.codegen_context import CallTable, Frame
from perilune.kernels.flight.records import INFO


def gather(f: Frame, t: CallTable, group: Int) -> None:
    """Fetch the lanes of a group; places beyond the batch repeat its last lane and are not active.

    Parameters
    ----------
    f
        Buffers of the function in the writing, which are filled.
    t
        Arrays of the call, which are read.
    group
        Index of the group; its lanes are `f.width` consecutive places in the order of flight.
    """
    w = f.w
    first = w.integer("mul", group, f.width)
    with w.loop(0, f.width) as k:
        place = w.integer("add", first, k)
        inside = w.below(place, t.lanes)
        final = w.integer("sub", t.lanes, 1)
        lane = w.load(t.order, w.choose(inside, INT, place, final))
        w.store(lane, f.lane, k)
        _copy_in(f, t.z0, w.integer("mul", lane, f.nz), f.state, f.nz, k)
        _copy_in(f, t.p, w.integer("mul", lane, t.p_stride), f.parameters, f.np, k)
        base = w.integer("mul", lane, w.integer("mul", f.nz, f.nc))
        with w.loop(0, f.kept) as c:
            source = w.integer("add", base, w.load(f.offsets, c))
            value = w.load(t.seeds, source)
            w.store(value, w.by_lane(f.state), w.entry(w.integer("add", c, f.nz), f.width, k))
        for number, array in enumerate((t.duration, t.rtol, t.atol, t.mode)):
            value = w.load(array, lane)
            w.store(value, f.elements(), w.entry(number, f.width, k))
        alive = w.let(NUM, f"uitofp i1 {inside} to double")
        w.store(alive, f.elements(), w.entry(4, f.width, k))
    for number, target in enumerate((f.duration, f.rtol, f.atol, f.mode)):
        w.store(w.load(f.element, number), target)
    w.store(w.compare("ogt", w.load(f.element, 4), w.const(0.0)), f.active)
    for target in (f.time, f.refused, f.steps, f.tries, f.status, f.events):
        w.store(w.const(0.0), target)


def _copy_in(f: Frame, source: Ptr[Num], base: Int, target: Ptr[Vec], count: Index, lane: Index) -> None:
    w = f.w
    with w.loop(0, count) as c:
        value = w.load(source, w.integer("add", base, c))
        w.store(value, w.by_lane(target), w.entry(c, f.width, lane))


def write_out(f: Frame, t: CallTable, ended: Mask) -> None:
    """Write state, rates, columns and report of the lanes that have ended: the first slopes are those of the state.

    Parameters
    ----------
    f
        Buffers of the function in the writing, which are read.
    t
        Arrays of the call, which are written.
    ended
        Lanes whose arcs have ended.
    """
    w = f.w
    report = {"time": f.time, "status": f.status, "steps": f.steps, "mode": f.mode, "events": f.events}
    for number, name in enumerate(INFO):
        w.store(w.load(report[name]), f.element, number)
    w.store(w.select(ended, w.const(1.0), w.const(0.0)), f.element, len(INFO))
    with w.loop(0, f.width) as k:
        flag = w.load(f.elements(), w.entry(len(INFO), f.width, k))
        with w.when(w.positive(flag)):
            lane = w.load(f.lane, k)
            _copy_out(f, f.state, t.z, w.integer("mul", lane, f.nz), f.nz, k)
            _copy_out(f, f.slopes[0], t.rates, w.integer("mul", lane, f.nz), f.nz, k)
            base = w.integer("mul", lane, w.integer("mul", f.nz, f.nc))
            with w.loop(0, f.kept) as c:
                value = w.load(w.by_lane(f.state), w.entry(w.integer("add", c, f.nz), f.width, k))
                w.store(value, t.columns, w.integer("add", base, w.load(f.offsets, c)))
            _copy_out(f, f.element, t.info, w.integer("mul", lane, len(INFO)), len(INFO), k)


def _copy_out(f: Frame, source: Ptr[Vec], target: Ptr[Num], base: Int, count: Index, lane: Index) -> None:
    w = f.w
    with w.loop(0, count) as c:
        value = w.load(w.by_lane(source), w.entry(c, f.width, lane))
        w.store(value, target, w.integer("add", base, c))
