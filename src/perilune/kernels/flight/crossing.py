"""Events inside the stepping loop, as LLVM IR: location is step control.

After each step the event functions g and their rates g' = dg/dz z' are evaluated at its end. A crossing
refuses the step and asks for one that ends at the zero of the cubic Hermite polynomial of g over the step; a
step that ends short of the zero is kept and the next aims at it by Newton's method. So the zero is approached
by whole DOP853 steps, with the accuracy of the arc itself (the interpolant of order 7 would lose some), the
columns come along, and the event fires where |g/g'| is below `TOLERANCE` of the duration. Two crossings
inside one step are looked for where the cubic dips through zero.

After an event the field, the events and (by `ArcSystem.transition`) state and columns are those of the new
mode.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from perilune.kernels.algebra.system import Event
from perilune.kernels.flight.arcs import MAX_EVENTS, ArcStatus
from perilune.kernels.flight.lanes import element

if TYPE_CHECKING:
    from perilune.kernels.flight.driver import Driver

#: How near to the zero, as a fraction of the duration, an event fires.
TOLERANCE = 1e-13
_AFTER = 1e-150  # stands for "just beyond zero": the sign of g after its own event; products of it stay finite
_BISECTIONS = 20  # after them Newton has two steps to the last digit
_WHOLE = 1.0 - 1e-15  # a refused step becomes shorter, if only by this


def allocate(d: Driver) -> None:
    """Make the buffers: g and g' at the start and at the end of a step, and which events fire."""
    count = len(d.system.events)
    if count:
        d.g_old, d.g_new, d.g_after = (d.w.buffer(2 * count) for _ in range(3))
        d.fired = d.w.buffer(count, d.w.mask)
        d.crossed = d.w.buffer(count, d.w.mask)


def begin(d: Driver) -> None:
    """Evaluate the events at the start."""
    if d.system.events:
        d.call("crossings", d.state, d.slopes, d.g_old)
        for number in range(len(d.system.events)):
            d.w.store(d.w.const_mask(False), d.fired, number, d.w.mask)


def locate(d: Driver, h: str, held: str) -> None:
    """Look for crossings in an accepted step; where there are, refuse it or let the event fire at its end."""
    events = d.system.events
    if not events:
        return
    w, count = d.w, len(events)
    d.call("crossings", d.new, d.slopes_after, d.g_new)
    accepted = w.load(held, kind=w.mask)
    theta, ahead = w.buffer(1), w.buffer(1)
    w.store(w.const(2.0), theta)
    w.store(w.const(math.inf), ahead)
    resolution = w.mul(w.intrinsic("fabs", w.load(d.duration)), w.const(TOLERANCE))
    for number, event in enumerate(events):
        _examine(d, number, event, h, accepted, resolution, theta, ahead)
    early = w.both(accepted, w.compare("olt", w.load(theta), w.const(1.5)))
    done = w.const_mask(False)
    for number in range(count):
        fires = w.but_not(w.but_not(w.load(d.fired, number, w.mask), early), done)
        w.store(fires, d.fired, number, w.mask)
        done = w.either(done, fires)
    kept = w.but_not(accepted, early)
    w.store(kept, held, kind=w.mask)
    limit = w.load(d.limit)
    approaching = w.both(w.but_not(kept, done), w.compare("olt", limit, w.const(math.inf)))
    after = w.select(approaching, w.load(ahead), w.select(kept, w.const(math.inf), limit))
    w.store(w.select(early, w.mul(w.load(theta), w.intrinsic("fabs", h)), after), d.limit)
    with w.loop(0, 2 * count) as c:
        w.store(w.select(w.but_not(kept, done), w.load(d.g_new, c), w.load(d.g_old, c)), d.g_old, c)


def _examine(
    d: Driver, number: int, event: Event, h: str, accepted: str, resolution: str, theta: str, ahead: str
) -> None:
    w, count, zero = d.w, len(d.system.events), d.w.const(0.0)
    watched = w.both(accepted, _watched(d, event))
    g0, g1 = w.load(d.g_old, number), w.load(d.g_new, number)
    rate0, rate1 = (w.mul(h, w.load(g, count + number)) for g in (d.g_old, d.g_new))  # over the step
    up, down = event.direction >= 0, event.direction <= 0
    rises = w.both(w.compare("olt", g0, zero), w.compare("oge", g1, zero)) if up else w.const_mask(False)
    falls = w.both(w.compare("ogt", g0, zero), w.compare("ole", g1, zero)) if down else w.const_mask(False)
    crosses = w.both(watched, w.either(rises, falls))
    to_rise = w.both(w.compare("olt", g1, zero), w.compare("ogt", rate1, zero)) if up else w.const_mask(False)
    to_fall = w.both(w.compare("ogt", g1, zero), w.compare("olt", rate1, zero)) if down else w.const_mask(False)
    heads = w.but_not(w.both(watched, w.either(to_rise, to_fall)), crosses)
    step = w.intrinsic("fabs", h)
    away = w.mul(step, w.intrinsic("fabs", w.div(g1, rate1)))
    near = w.either(w.compare("ole", away, resolution), w.compare("oeq", g1, zero))
    same_side = w.compare("ogt", w.mul(g0, g1), zero)  # not just left by its own event
    arrives = w.either(
        w.both(crosses, w.either(near, w.compare("ole", step, resolution))),
        w.both(w.both(heads, same_side), near),
    )
    w.store(arrives, d.fired, number, w.mask)
    w.store(crosses, d.crossed, number, w.mask)
    nearer = w.smaller(away, w.load(ahead))
    w.store(w.select(heads, nearer, w.load(ahead)), ahead)
    inside = w.but_not(crosses, arrives)
    with w.when(w.any(inside)):
        _aim(w, inside, (g0, g1, rate0, rate1), theta, derivative=False)
    turns = w.both(w.compare("olt", w.mul(g0, rate0), zero), w.compare("ogt", w.mul(g1, rate1), zero))
    dips = w.both(w.but_not(watched, crosses), w.both(same_side, turns))
    with w.when(w.any(dips)):
        _aim(w, dips, (g0, g1, rate0, rate1), theta, derivative=True)


def _watched(d: Driver, event: Event) -> str:
    w, mask = d.w, d.w.const_mask(False)
    for mode in range(len(d.system.modes)):
        if event.watched(mode):
            mask = w.either(mask, w.compare("oeq", w.load(d.mode), w.const(float(mode))))
    return mask


def _aim(w, mask: str, ends: tuple[str, str, str, str], theta: str, *, derivative: bool) -> None:
    """Bisect the Hermite cubic for its zero, or its slope for a dip through zero; the earliest counts."""
    g0, g1, rate0, rate1 = ends
    jump = w.sub(g1, g0)
    c2 = w.sub(w.mul(w.const(3.0), jump), w.fma(w.const(2.0), rate0, rate1))
    c3 = w.sub(w.add(rate0, rate1), w.mul(w.const(2.0), jump))

    def cubic(x: str) -> str:
        return w.fma(w.fma(w.fma(c3, x, c2), x, rate0), x, g0)

    def slope(x: str) -> str:
        return w.fma(w.fma(w.mul(w.const(3.0), c3), x, w.mul(w.const(2.0), c2)), x, rate0)

    at = slope if derivative else cubic
    start = rate0 if derivative else g0
    low, high = w.buffer(1), w.buffer(1)
    w.store(w.const(0.0), low)
    w.store(w.const(1.0), high)
    with w.loop(0, _BISECTIONS):
        middle = w.mul(w.const(0.5), w.add(w.load(low), w.load(high)))
        before = w.compare("ogt", w.mul(at(middle), w.intrinsic("copysign", w.const(1.0), start)), w.const(0.0))
        w.store(w.select(before, middle, w.load(low)), low)
        w.store(w.select(before, w.load(high), middle), high)
    found = w.load(high)
    if not derivative:
        for _ in range(2):
            nearer = w.sub(found, w.div(cubic(found), slope(found)))
            within = w.both(w.compare("ogt", nearer, w.load(low)), w.compare("olt", nearer, w.load(high)))
            found = w.select(within, nearer, found)
    if derivative:
        through = w.compare("olt", w.mul(cubic(found), g0), w.const(0.0))
        inner = w.both(w.compare("ogt", found, w.const(1e-9)), w.compare("olt", found, w.const(_WHOLE)))
        mask = w.both(mask, w.both(through, inner))
    found = w.smaller(w.larger(found, w.const(1e-3)), w.const(_WHOLE))
    earlier = w.both(mask, w.compare("olt", found, w.load(theta)))
    w.store(w.select(earlier, found, w.load(theta)), theta)


def fire(d: Driver) -> None:
    """Note the events at the end of the committed step, and end the arc or change its mode."""
    if not d.system.events:
        return
    w = d.w
    masks = [w.load(d.fired, number, w.mask) for number in range(len(d.system.events))]
    any_mask = masks[0]
    for mask in masks[1:]:
        any_mask = w.either(any_mask, mask)
    with w.when(w.any(any_mask)):
        for number, mask in enumerate(masks):
            _log(d, number, mask)
        w.store(w.select(any_mask, w.add(w.load(d.events), w.const(1.0)), w.load(d.events)), d.events)
        d.mark(
            w.both(any_mask, w.compare("oge", w.load(d.events), w.const(float(MAX_EVENTS)))),
            ArcStatus.STEP_LIMIT,
        )
        for mask, event in zip(masks, d.system.events, strict=True):
            if event.terminal:
                d.mark(mask, ArcStatus.EVENT)
        if d.system.transitions:
            _transit(d, masks)
            d.field(d.state, d.new)
            d.blend(any_mask, d.new, d.slopes, d.n)
        _look_again(d, masks, any_mask)
        w.store(w.select(any_mask, w.const(math.inf), w.load(d.limit)), d.limit)
    for number in range(len(masks)):
        w.store(w.const_mask(False), d.fired, number, w.mask)


def _log(d: Driver, number: int, mask: str) -> None:
    w = d.w
    with w.when(w.any(mask)):
        w.store(w.load(d.time), d.element, 0)
        w.store(w.load(d.events), d.element, 1)
        w.store(w.select(mask, w.const(1.0), w.const(0.0)), d.element, 2)
        with w.loop(0, d.width) as k:
            time, met, flag = (w.load(d.element, element(d, str(i), k), "double") for i in range(3))
            room = w.let(f"fcmp olt double {met}, {float(MAX_EVENTS)}")
            with w.when(w.let(f"and i1 {room}, {w.let(f'fcmp ogt double {flag}, 0.0')}")):
                row = w.let(f"mul i64 {w.load(d.lane, k, 'i64')}, {2 * MAX_EVENTS}")
                place = w.let(f"shl i64 {w.let(f'fptosi double {met} to i64')}, 1")
                entry = w.at(d.table["log"], w.let(f"add i64 {row}, {place}"), "double")
                w.store(f"{float(number)}", entry, 0, "double")
                w.store(time, entry, 1, "double")


def _transit(d: Driver, masks: list[str]) -> None:
    """Carry state, columns and mode over the events."""
    w, mode = d.w, d.w.load(d.mode)
    new_mode = mode
    for number, before, after in d.system.transitions:
        here = w.both(masks[number], w.compare("oeq", mode, w.const(float(before))))
        with w.when(w.any(here)):
            d.call(f"transition{number}_{before}", d.state, d.new)
            d.blend(here, d.new, d.state, d.n)
        new_mode = w.select(here, w.const(float(after)), new_mode)
    w.store(new_mode, d.mode)


def _look_again(d: Driver, masks: list[str], any_mask: str) -> None:
    """Evaluate the events after one: its own g counts as passed, one that crossed with it as ahead."""
    w = d.w
    count = len(masks)
    d.call("crossings", d.state, d.slopes, d.g_after)
    for number, mask in enumerate(masks):
        old = w.load(d.g_old, number)
        pending = w.both(any_mask, w.load(d.crossed, number, w.mask))
        value = w.select(any_mask, w.load(d.g_after, number), old)
        value = w.select(pending, w.intrinsic("copysign", w.const(_AFTER), old), value)
        w.store(w.select(mask, w.intrinsic("copysign", w.const(_AFTER), w.neg(old)), value), d.g_old, number)
        rate = w.load(d.g_after, count + number)
        w.store(w.select(any_mask, rate, w.load(d.g_old, count + number)), d.g_old, count + number)
