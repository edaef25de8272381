"""Transcendental functions on vectors of lanes, as LLVM IR.

A processor multiplies, divides and takes square roots in vectors but has no vector sine. Calling the C
library lane by lane would stop the whole kernel, so the functions that trajectories use are polynomials here,
each a function of its own that the compiler may inline. Errors are bounded in units in the last place (ulp)
by a test for every one.

Sources: argument reductions and polynomials of sin, cos and log from fdlibm (Sun Microsystems 1993); atan
and tanh from S. L. Moshier, *Cephes*, 1989; exp and sinh by their series on the reduced interval. Arguments
of sin and cos beyond 2^19, and the functions in `LIBRARY`, go to the C library lane by lane.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from perilune.kernels.code.ir import NUM, Bits, Num, Vec, Writer

#: Called in the C library, lane by lane; value: number of arguments.
LIBRARY = {"pow": 2, "asinh": 1, "acosh": 1, "atanh": 1, "log1p": 1, "expm1": 1, "hypot": 2}

#: For a single lane: the C library is accurate to a rounding and as quick.
_SCALAR_LIBRARY = {
    "sin": 1, "cos": 1, "tan": 1, "asin": 1, "acos": 1, "atan": 1, "atan2": 2,
    "sinh": 1, "cosh": 1, "tanh": 1, "exp": 1, "log": 1,
}  # fmt: skip

_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to a whole number held in the low bits
_SIN = (1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
        -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01)  # fmt: skip
_COS = (-1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
        2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02)  # fmt: skip
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_LOG = (
    1.479819860511658591e-01, 1.531383769920937332e-01, 1.818357216161805012e-01, 2.222219843214978396e-01,
    2.857142874366239149e-01, 3.999999999940941908e-01, 6.666666666666735130e-01,
)  # fmt: skip
_ATAN_P = (-8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
           -1.228866684490136173410e2, -6.485021904942025371773e1)  # fmt: skip
_ATAN_Q = (1.0, 2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2,
           4.853903996359136964868e2, 1.945506571482613964425e2)  # fmt: skip
_TANH_P = (-9.64399179425052238628e-1, -9.92877231001918586564e1, -1.61468768441708447952e3)
_TANH_Q = (1.0, 1.12811678491632931402e2, 2.23548839060100448583e3, 4.84406305325125486048e3)


def call(w: Writer, name: str, *operands: Vec) -> Vec:
    """Append a call of a transcendental function; its definition comes from `definitions`.

    Parameters
    ----------
    w
        Writer of the function that the call is appended to.
    name
        Name of the function, one of `NAMES`.
    *operands
        One or two arguments, a double in each lane.
    """
    arguments = ", ".join(f"{w.vector} {x}" for x in operands)
    return w.let(w.vector, f"call {w.vector} @perilune.{name}({arguments})")


def definitions(width: int, names: set[str]) -> str:
    """Return the IR of the functions named and of those that they use.

    Parameters
    ----------
    width
        Number of lanes of a vector.
    names
        Names of functions, of `NAMES`.
    """
    vector, texts, done = width > 1, [], set()
    pending = sorted(names)
    while pending:
        name = pending.pop()
        if name in done:
            continue
        done.add(name)
        if name in LIBRARY or not vector:
            texts.append(_lane_by_lane(width, name, (LIBRARY | _SCALAR_LIBRARY)[name]))
        else:
            write, arity, uses = _VECTOR[name]
            pending.extend(uses)
            texts.append(_define(width, name, arity, write))
    return "\n".join(texts)


def _define(width: int, name: str, arity: int, write: Callable[..., Vec]) -> str:
    w = Writer(width)
    parameters = [Vec(f"%a{i}") for i in range(arity)]
    result = write(w, *parameters)
    signature = ", ".join(f"{w.vector} {x}" for x in parameters)
    return (f"define internal {w.vector} @perilune.{name}({signature}) nounwind willreturn memory(none) {{\n"
            f"{w.body()}\n  ret {w.vector} {result}\n}}\n")  # fmt: skip


def _lane_by_lane(width: int, name: str, arity: int) -> str:
    def write(w: Writer, *operands: Vec) -> Vec:
        def called(lane: int) -> Num:
            values = [w.lane(x, lane) for x in operands]
            return w.let(NUM, f"call double @{name}({', '.join(f'double {v}' for v in values)})")

        return w.gathered(called)

    declaration = f"declare double @{name}({', '.join(['double'] * arity)}) nounwind willreturn memory(none)\n"
    return declaration + _define(width, name, arity, write)


# -- pieces
# ----------------------------------------------------------------------------------------------------
def _as_integer(w: Writer, x: Vec) -> Bits:
    return w.let(w.integers, f"bitcast {w.vector} {x} to {w.integers}")


def _as_double(w: Writer, x: Bits) -> Vec:
    return w.let(w.vector, f"bitcast {w.integers} {x} to {w.vector}")


def _integer(w: Writer, op: str, a: Bits, b: Bits) -> Bits:
    return w.let(w.integers, f"{op} {w.integers} {a}, {b}")


def _reduced(w: Writer, x: Vec) -> tuple[Vec, Bits]:
    """Reduce x = n pi/2 + r with |r| <= pi/4; returns r and the bits of n. Good for |x| < 2^19."""
    shifted = w.add(w.mul(x, w.const(2 / math.pi)), w.const(_ROUND))
    n = w.sub(shifted, w.const(_ROUND))
    r = x
    for part in _HALF_PI:
        r = w.fma(n, w.const(-part), r)
    return r, _as_integer(w, shifted)


def _quadrant(w: Writer, x: Vec, advance: int) -> Vec:
    """Return sin(x + advance pi/2): the polynomial that the quadrant asks for, with its sign."""
    r, n = _reduced(w, x)
    z = w.mul(r, r)
    sine = w.fma(w.mul(z, r), w.horner(z, _SIN), r)
    half = w.mul(z, w.const(0.5))
    one = w.sub(w.const(1.0), half)
    lost = w.sub(w.sub(w.const(1.0), one), half)
    cosine = w.add(one, w.fma(w.mul(z, z), w.horner(z, _COS), lost))
    quadrant = _integer(w, "add", n, w.bits(advance))
    odd = w.let(w.mask, f"trunc {w.integers} {quadrant} to {w.mask}")
    flip = _integer(w, "shl", _integer(w, "and", quadrant, w.bits(2)), w.bits(62))
    return _as_double(w, _integer(w, "xor", _as_integer(w, w.select(odd, cosine, sine)), flip))


def _periodic(name: str, advance: int) -> Callable[..., Vec]:
    def write(w: Writer, x: Vec) -> Vec:
        result = w.buffer(1)
        w.store(_quadrant(w, x, advance), result)
        far = w.any(w.compare("ogt", w.intrinsic("fabs", x), w.const(2.0**19)))
        with w.when(far):
            w.store(call(w, f"far_{name}", x), result)
        return w.load(result)

    return write


def _library_function(name: str) -> Callable[..., Vec]:
    """Return the function for angles beyond the reduction: the library's, out of line."""

    def write(w: Writer, x: Vec) -> Vec:
        return w.intrinsic(name, x)

    return write


def _tan(w: Writer, x: Vec) -> Vec:
    return w.div(call(w, "sin", x), call(w, "cos", x))


def _exp_by_reduction(w: Writer, x: Vec) -> Vec:
    x = w.select(w.compare("ogt", x, w.const(720.0)), w.const(720.0), x)
    x = w.select(w.compare("olt", x, w.const(-760.0)), w.const(-760.0), x)
    n = w.sub(w.add(w.mul(x, w.const(1 / math.log(2))), w.const(_ROUND)), w.const(_ROUND))
    r = w.fma(n, w.const(-_LN2[1]), w.fma(n, w.const(-_LN2[0]), x))
    tail = w.horner(r, tuple(1 / math.factorial(k) for k in range(13, 1, -1)))
    value = w.add(w.const(1.0), w.fma(w.mul(r, r), tail, r))
    # 2^n in two factors, so that results below the normal range and above it come out right.
    half = w.sub(w.add(w.mul(n, w.const(0.5)), w.const(_ROUND)), w.const(_ROUND))
    for part in (half, w.sub(n, half)):
        exponent = _integer(w, "add", _as_integer(w, w.add(part, w.const(_ROUND))), w.bits(1023))
        value = w.mul(value, _as_double(w, _integer(w, "shl", exponent, w.bits(52))))
    return value


def _log(w: Writer, x: Vec) -> Vec:
    small = w.compare("olt", x, w.const(2.0**-1022))
    bits = _as_integer(w, w.select(small, w.mul(x, w.const(2.0**54)), x))
    # The exponent that leaves a mantissa in [sqrt(1/2), sqrt(2)), biased to stay positive.
    shifted = _integer(w, "add", bits, w.bits((1024 << 52) - 0x3FE6A09E667F3BCD))
    biased = _integer(w, "lshr", shifted, w.bits(52))
    exponent = _integer(w, "shl", _integer(w, "sub", biased, w.bits(1024)), w.bits(52))
    mantissa = _as_double(w, _integer(w, "sub", bits, exponent))
    k = w.sub(_as_double(w, _integer(w, "add", biased, w.bits(0x4338000000000000))), w.const(_ROUND + 1024.0))
    k = w.sub(k, w.select(small, w.const(54.0), w.const(0.0)))
    f = w.sub(mantissa, w.const(1.0))
    s = w.div(f, w.add(w.const(2.0), f))
    z = w.mul(s, s)
    remainder = w.mul(z, w.horner(z, _LOG))
    half = w.mul(w.const(0.5), w.mul(f, f))
    inner = w.fma(s, w.add(half, remainder), w.mul(k, w.const(_LN2[1])))
    value = w.sub(w.mul(k, w.const(_LN2[0])), w.sub(w.sub(half, inner), f))
    value = w.select(w.compare("oeq", x, w.const(math.inf)), x, value)
    value = w.select(w.compare("oeq", x, w.const(0.0)), w.const(-math.inf), value)
    return w.select(w.compare("uge", x, w.const(0.0)), w.select(w.compare("uno", x, x), x, value), w.const(math.nan))


def _atan2_by_octants(w: Writer, y: Vec, x: Vec) -> Vec:
    """Return atan2 by the angle of the first octant from the ratio of the smaller to the larger, then reflected."""
    wide, high = w.intrinsic("fabs", x), w.intrinsic("fabs", y)
    steep = w.compare("ogt", high, wide)
    large, small = w.select(steep, high, wide), w.select(steep, wide, high)
    ratio = w.select(w.compare("oeq", small, large), w.const(1.0), w.div(small, large))
    ratio = w.select(w.compare("oeq", large, w.const(0.0)), w.const(0.0), ratio)
    upper = w.compare("ogt", ratio, w.const(0.66))
    t = w.select(upper, w.div(w.sub(ratio, w.const(1.0)), w.add(ratio, w.const(1.0))), ratio)
    z = w.mul(t, t)
    value = w.fma(w.mul(t, z), w.div(w.horner(z, _ATAN_P), w.horner(z, _ATAN_Q)), t)
    low = w.select(upper, w.const(3.061616997868382943e-17), w.const(0.0))  # what pi/4 loses as a double
    value = w.add(w.select(upper, w.const(math.pi / 4), w.const(0.0)), w.add(value, low))
    turned = w.sub(w.const(math.pi / 2), w.sub(value, w.const(6.123233995736766e-17)))
    value = w.select(steep, turned, value)
    behind = w.let(w.mask, f"icmp slt {w.integers} {_as_integer(w, x)}, {w.bits(0)}")
    turned = w.sub(w.const(math.pi), w.sub(value, w.const(1.2246467991473532e-16)))
    value = w.select(behind, turned, value)
    value = w.select(w.compare("uno", x, y), w.add(x, y), value)
    return w.intrinsic("copysign", value, y)


def _other_leg(w: Writer, x: Vec) -> Vec:
    return w.intrinsic("sqrt", w.mul(w.sub(w.const(1.0), x), w.add(w.const(1.0), x)))


def _sinh(w: Writer, x: Vec) -> Vec:
    size = w.intrinsic("fabs", x)
    e = call(w, "exp", size)
    large = w.mul(w.const(0.5), w.sub(e, w.div(w.const(1.0), e)))
    z = w.mul(x, x)
    small = w.fma(w.mul(size, z), w.horner(z, tuple(1 / math.factorial(k) for k in range(19, 1, -2))), size)
    return w.intrinsic("copysign", w.select(w.compare("olt", size, w.const(1.0)), small, large), x)


def _cosh(w: Writer, x: Vec) -> Vec:
    e = call(w, "exp", w.intrinsic("fabs", x))
    return w.mul(w.const(0.5), w.add(e, w.div(w.const(1.0), e)))


def _tanh(w: Writer, x: Vec) -> Vec:
    size = w.intrinsic("fabs", x)
    z = w.mul(x, x)
    small = w.fma(w.mul(size, z), w.div(w.horner(z, _TANH_P), w.horner(z, _TANH_Q)), size)
    e = call(w, "exp", w.add(size, size))
    large = w.sub(w.const(1.0), w.div(w.const(2.0), w.add(e, w.const(1.0))))
    return w.intrinsic("copysign", w.select(w.compare("olt", size, w.const(0.625)), small, large), x)


#: name: (writer, number of arguments, functions used)
_VECTOR: dict[str, tuple[Callable[..., Vec], int, list[str]]] = {
    "sin": (_periodic("sin", 0), 1, ["far_sin"]),
    "cos": (_periodic("cos", 1), 1, ["far_cos"]),
    "far_sin": (_library_function("sin"), 1, []),
    "far_cos": (_library_function("cos"), 1, []),
    "tan": (_tan, 1, ["sin", "cos"]),
    "exp": (_exp_by_reduction, 1, []),
    "log": (_log, 1, []),
    "atan2": (_atan2_by_octants, 2, []),
    "atan": (lambda w, x: call(w, "atan2", x, w.const(1.0)), 1, ["atan2"]),
    "asin": (lambda w, x: call(w, "atan2", x, _other_leg(w, x)), 1, ["atan2"]),
    "acos": (lambda w, x: call(w, "atan2", _other_leg(w, x), x), 1, ["atan2"]),
    "sinh": (_sinh, 1, ["exp"]),
    "cosh": (_cosh, 1, ["exp"]),
    "tanh": (_tanh, 1, ["exp"]),
}
NAMES = frozenset(_VECTOR) | frozenset(LIBRARY)
