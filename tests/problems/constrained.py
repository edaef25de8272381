"""Problems whose answers ride along a condition on states, or touch it, with their closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import root_scalar

import perilune as pl
from perilune.problem import Parameter, Variable


def _variables(**units: str) -> tuple[Variable, ...]:
    return tuple(Variable(name=name, unit=unit) for name, unit in units.items())


def _given(**values: tuple[float, str]) -> dict[str, Parameter]:
    return {name: Parameter(value=value, unit=unit) for name, (value, unit) in values.items()}


def bryson_denham(ceiling: float, as_bound: bool = False) -> pl.Problem:
    """From (0, 1) to (0, -1) in 1 s with the least int u^2/2 and x <= l, as a path condition or as a bound of x.

    Bryson, Denham, Dreyfus 1963: for l < 1/6 the flight rides along x = l from 3 l to 1 - 3 l and J = 4/(9 l), for
    l < 1/4 it touches at 1/2 and J = 2 + 6 (1 - 4 l)^2.
    """
    x = Variable(name="x", unit="m", upper=ceiling if as_bound else math.inf)
    phase = pl.Phase(
        name="swing",
        states=(x, *_variables(v="m/s", c="m^2/s^3")),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x, x.v + p.speed), back="m", turned="m/s"),
        path=pl.Conditions.of(
            None if as_bound else lambda x, u, p, xp: (p.ceiling - x.x,), () if as_bound else _variables(room="m")
        ),
    )
    return pl.Problem(
        name="bryson_denham",
        phases=(phase,),
        start=lambda p, xp: (0.0, p.speed, 0.0),
        given=_given(T=(1.0, "s"), speed=(1.0, "m/s"), ceiling=(ceiling, "m")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


def bryson_denham_truth(ceiling: float) -> float:
    """J of `bryson_denham` [m^2/s^3]: it rides along the ceiling, touches it, or stays below."""
    return 4 / (9 * ceiling) if ceiling <= 1 / 6 else 2 + 6 * max(1 - 4 * ceiling, 0.0) ** 2


def timed_bryson_denham(ceiling: float, low: float, high: float, price: float = 0.0) -> pl.Problem:
    """The same with a duration T between bounds, of which each second saves w: J = J(l/T)/T - w T.

    Along the ceiling J = 4/(9 l) - w T, and elsewhere it falls with T too: T is at its longest for w > 0, and for
    w < 0 at its shortest where that rides, T >= 6 l.
    """
    whole = bryson_denham(ceiling)
    swing = replace(whole.phases[0], dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u - p.w))
    return replace(
        whole,
        phases=(swing,),
        given={name: g for name, g in whole.given.items() if name != "T"} | _given(w=(price, "m^2/s^4")),
        free=(pl.FreeParameter(name="T", unit="s", lower=low, upper=high, guess=0.9),),
    )


def timed_bryson_denham_truth(ceiling: float, duration: float, price: float = 0.0) -> float:
    """J of `timed_bryson_denham` at a duration [s]."""
    return bryson_denham_truth(ceiling / duration) / duration - price * duration


def weak_bryson_denham(ceiling: float, most: float) -> pl.Problem:
    """The same with u^2 <= a^2 as another condition of the path, which the control keeps."""
    whole = bryson_denham(ceiling)
    swing = replace(
        whole.phases[0],
        path=pl.Conditions(lambda x, u, p, xp: (p.ceiling - x.x, 1 - (u.u / p.most) ** 2), room="m", strength="1"),
    )
    given = {**whole.given, **_given(most=(most, "m/s^2"))}
    return replace(whole, name="weak_bryson_denham", phases=(swing,), given=given)


def weak_bryson_denham_truth(ceiling: float, most: float) -> float:
    """J of `weak_bryson_denham` with l < 1/6: below a = 2/(3 l) it brakes by a at first, and then less for d seconds.

    v = 0 and x = l where it meets the ceiling give d^2 = 24 (l - 1/(2 a))/a, and J = a - a^2 d/6.
    """
    if most >= 2 / (3 * ceiling):
        return bryson_denham_truth(ceiling)
    return most - most**2 / 6 * math.sqrt(24 * (ceiling - 0.5 / most) / most)


def parked(ceiling: float) -> pl.Problem:
    """The same to rest *on* the ceiling: it rides along x = l from 3 l to the end and J = 2/(9 l), for l < 1/3.

    Both end conditions hold all along the arc, one of them as a multiple of the rate of its condition.
    """
    whole = bryson_denham(ceiling)
    swing = replace(
        whole.phases[0],
        end=pl.Conditions(lambda x, p, xp: (p.ceiling - x.x, 2 * x.v), there="m", still="m/s"),
    )
    return replace(whole, name="parked", phases=(swing,))


FROM, UNTIL = 0.5, 1.4  # s, between which `drawn_off` rides along the floor


def drawn_off() -> pl.Problem:
    """To rest on the floor x >= 0 with the least int (u - a)^2/2, a = (t - 2)^3: it rides along it, and leaves.

    Along the floor u = 0 and eta = lam_v - a, so that mu = -a'' = 6 (2 - t): riding on to the end gains by leaving from
    2 s on. Off the floor u - a = -lam_v is linear in t. It is left with u = 0, at the time from which s from there on
    u = k (0.3 L^2 s - 1.2 L s^2 + s^3) leads back to rest on it after L = 1.5 s: at 2 - 0.4 L. It is met with u = 0 as
    well; where the flight begins is what leads there with lam_v' = 20 m/s^3.
    """
    phase = pl.Phase(
        name="flight",
        states=_variables(x="m", v="m/s", t="s", c="m^2/s^3"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 1.0, 0.5 * (u.u - p.k * (x.t - p.turn) ** 3) ** 2),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x, x.v), down="m", still="m/s"),
        path=pl.Conditions(lambda x, u, p, xp: (x.x,), height="m"),
    )
    bend, lag = 20.0 - 3.0 * (FROM - 2.0) ** 2, FROM - 2.0
    x0 = bend * FROM**3 / 6 + lag * FROM**4 / 4 - FROM**5 / 20
    v0 = -(bend * FROM**2 / 2 + lag * FROM**3 - FROM**4 / 4)
    return pl.Problem(
        name="drawn_off",
        phases=(phase,),
        start=lambda p, xp: (p.x0, p.v0, 0.0, 0.0),
        given=_given(T=(2.9, "s"), k=(1.0, "m/s^5"), turn=(2.0, "s"), x0=(x0, "m"), v0=(v0, "m/s")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


HOP = 1e-4  # m/s^4, of which the hop of `hopping` is 0.5^4/384


def hopping() -> pl.Problem:
    """To rest on the floor x >= 0 after 1 s with the least int (u - a)^2/2, a = k t^2/2: a touch at 0.5 s, and a hop.

    mu = -a'' = -k along the floor, where nothing rides therefore. From its touch at rest to rest after L = 0.5 s it
    hops over x = k s^2 (L - s)^2/24, which is 1.6e-8 m at most. Before, with r to go to the touch and u as it is
    behind, u = k (L^2/12 + r^2/2) + 10 m/s^3 r: the costate of x jumps by 10 m/s^3 - k L/2.
    """
    phase = pl.Phase(
        name="flight",
        states=_variables(x="m", v="m/s", t="s", c="m^2/s^3"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 1.0, 0.5 * (u.u - 0.5 * p.k * x.t**2) ** 2),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x, x.v), down="m", still="m/s"),
        path=pl.Conditions(lambda x, u, p, xp: (x.x,), height="m"),
    )
    r, bend = 0.5, HOP * 0.5**2 / 12
    x0 = bend * r**2 / 2 + 10.0 * r**3 / 6 + HOP * r**4 / 24
    v0 = -(bend * r + 10.0 * r**2 / 2 + HOP * r**3 / 6)
    return pl.Problem(
        name="hopping",
        phases=(phase,),
        start=lambda p, xp: (p.x0, p.v0, 0.0, 0.0),
        given=_given(T=(1.0, "s"), k=(HOP, "m/s^4"), x0=(x0, "m"), v0=(v0, "m/s")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


SLOPE, OFFSET = 0.5, 0.1


def brachistochrone() -> pl.Problem:
    """Least time over x = 1 m from rest under g = 1 m/s^2, nowhere below the line y = x/2 + 0.1 m (y points down)."""
    phase = pl.Phase(
        name="slide",
        states=_variables(x="m", y="m", v="m/s"),
        controls=(pl.UnitVectorControl(names=("c", "s")),),
        dynamics=lambda x, u, p, xp: (x.v * u.c, x.v * u.s, p.g * u.s),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far,), across="m"),
        path=pl.Conditions(lambda x, u, p, xp: (p.slope * x.x + p.offset - x.y,), above="m"),
        end_guess=lambda p, xp: (p.far, p.slope * p.far, xp.sqrt(p.g * p.far)),
    )
    return pl.Problem(
        name="brachistochrone",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=_given(g=(1.0, "m/s^2"), far=(1.0, "m"), slope=(SLOPE, "1"), offset=(OFFSET, "m")),
        free=(pl.FreeParameter(name="T", unit="s", upper=10.0, lower=0.0, guess=1.8),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
    )


def brachistochrone_truth(offset: float = OFFSET) -> tuple[float, float, float]:
    """When the line is met, when it is left, and the least time [s]: a cycloid, the line, a cycloid, each tangent.

    On a cycloid x = R (phi - sin phi), y = R (1 - cos phi) the slope is cot(phi/2) and the time sqrt(R/g) phi; the last
    one ends level, at phi = pi.
    """
    phi = 2 * math.atan(1 / SLOPE)
    high, wide = 1 - math.cos(phi), phi - math.sin(phi)
    first = offset / (high - SLOPE * wide)
    last = (SLOPE + offset) / (high + SLOPE * (math.pi - wide))
    met, gained = first * high, last * high  # heights fallen, where speeds are sqrt(2 y)
    along = (math.sqrt(2 * gained) - math.sqrt(2 * met)) * math.hypot(1, SLOPE) / SLOPE
    entered = math.sqrt(first) * phi
    return entered, entered + along, entered + along + math.sqrt(last) * (math.pi - phi)


def mars_glide_slope() -> pl.Problem:
    """Landing on Mars above a rounded cone of 4 degrees, in a plane: it is touched once (Acikmese, Ploen 2007)."""
    cant = math.radians(27.0)
    phase = pl.Phase(
        name="descent",
        states=_variables(up="m", x="m", vu="m/s", vx="m/s", m="kg"),
        controls=(
            pl.UnitVectorControl(names=("du", "dx")),
            pl.ScalarControl(name="T", unit="N", lower="least", upper="most"),
        ),
        dynamics=lambda x, u, p, xp: (x.vu, x.vx, u.T / x.m * u.du - p.g, u.T / x.m * u.dx, -u.T * p.alpha),
        duration="flight_time",
        end=pl.Conditions(lambda x, p, xp: (x.up, x.x, x.vu, x.vx), down="m", there="m", sinking="m/s", drifting="m/s"),
        path=pl.Conditions(
            lambda x, u, p, xp: (x.up - p.slope * (xp.sqrt(x.x * x.x + p.pad * p.pad) - p.pad),), glide="m"
        ),
        end_guess=lambda p, xp: (0.0, 0.0, 0.0, 0.0, 0.8 * p.m0),
    )
    return pl.Problem(
        name="mars_glide_slope",
        phases=(phase,),
        start=lambda p, xp: (p.h, p.d, -p.sinking, p.across, p.m0),
        given=_given(
            g=(3.7114, "m/s^2"),
            alpha=(1 / (225 * 9.807 * math.cos(cant)), "s/m"),
            m0=(1905.0, "kg"),
            h=(1500.0, "m"),
            d=(2000.0, "m"),
            sinking=(75.0, "m/s"),
            across=(100.0, "m/s"),
            least=(6 * 0.3 * 3100 * math.cos(cant), "N"),
            most=(6 * 0.8 * 3100 * math.cos(cant), "N"),
            slope=(math.tan(math.radians(4.0)), "1"),
            pad=(1.0, "m"),
        ),
        free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.0, upper=200.0, guess=70.0),),
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
        results=pl.Quantities(lambda first, last, p, xp: (first.m - last.m, p.flight_time), propellant="kg", time="s"),
        scales=pl.Scales(length=2000.0, time=40.0, mass=1905.0),
    )


def speed_limit(limit: float) -> pl.Problem:
    """A vertical lunar descent from 2 km and 20 m/s, never faster than a limit: a fall, steady, full thrust."""
    phase = pl.Phase(
        name="descent",
        states=_variables(h="m", v="m/s", m="kg"),
        controls=(pl.ScalarControl(name="T", unit="N", lower="least", upper="most"),),
        dynamics=lambda x, u, p, xp: (x.v, u.T / x.m - p.g, -u.T / p.c),
        duration="flight_time",
        end=pl.Conditions(lambda x, p, xp: (x.h, x.v), down="m", still="m/s"),
        path=pl.Conditions(lambda x, u, p, xp: (p.limit + x.v,), room="m/s"),
        end_guess=lambda p, xp: (0.0, 0.0, 0.8 * p.m0),
    )
    return pl.Problem(
        name="speed_limit",
        phases=(phase,),
        start=lambda p, xp: (p.h0, p.v0, p.m0),
        given=_given(h0=(2000.0, "m"), v0=(-20.0, "m/s"), m0=(1000.0, "kg"), g=(1.62, "m/s^2"), c=(3000.0, "m/s"),
                     least=(0.0, "N"), most=(4000.0, "N"), limit=(limit, "m/s")),
        free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.0, upper=1000.0, guess=80.0),),
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
        scales=pl.Scales(length=2000.0, time=35.0, mass=1000.0),
    )  # fmt: skip


def speed_limit_truth(limit: float, **others: float) -> tuple[float, float, float]:
    """When the limit is met, when it is left [s], and the mass that lands [kg]: by the rocket equation."""
    p = {**{name: given.value for name, given in speed_limit(limit).given.items()}, **others}
    g, c, burn = p["g"], p["c"], p["most"] / p["c"]
    fallen = (limit + p["v0"]) / g
    high = p["h0"] + p["v0"] * fallen - 0.5 * g * fallen**2

    def braking(mass: float) -> tuple[float, float]:
        """How long it takes from the limit to rest [s], and over what height [m]."""
        t = _root(lambda t: c * math.log(mass / (mass - burn * t)) - g * t - limit, 1.0, 0.5 * mass / burn)
        left = mass - burn * t
        return t, limit * t + 0.5 * g * t * t - c * (t - left / burn * math.log(mass / left))

    def missed(steady: float) -> float:
        return high - limit * steady - braking(p["m0"] * math.exp(-g * steady / c))[1]

    steady = _root(missed, 0.0, high / limit)
    mass = p["m0"] * math.exp(-g * steady / c)
    return fallen, fallen + steady, mass - burn * braking(mass)[0]


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(root_scalar(function, bracket=(low, high), xtol=1e-14, rtol=1e-14).root)


MU, RADIUS, TURNS = 3.986005e14, 6.371e6, 7.2921159e-5


def deorbit(count: int = 2) -> pl.Problem:
    """Least time from a circular orbit to a place: three quarters round with the engine on, then a fall through air.

    The transition, in so many legs of equal length, may not come below 120 km, and touches that half way; it ends there
    with 7.5 km/s, 6 degrees below the horizon. Axes turn with the Earth.
    """
    start, velocity = _orbit(math.radians(39.5), math.radians(16.0))
    normal = np.cross(start, velocity + np.cross([0.0, 0.0, TURNS], start))
    normal /= np.linalg.norm(normal)
    ahead = start / np.linalg.norm(start)
    site = _unit(math.radians(38.0), math.radians(-98.0))

    def gravity(x: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        r = xp.sqrt(x.x * x.x + x.y * x.y + x.z * x.z)
        k, f, g = 1.5 * p.j2 * (p.radius / r) ** 2, 5 * (x.z / r) ** 2, -p.mu / r**3
        turning = p.turns**2
        return (
            g * x.x * (1 + k * (1 - f)) + 2 * p.turns * x.vy + turning * x.x,
            g * x.y * (1 + k * (1 - f)) - 2 * p.turns * x.vx + turning * x.y,
            g * x.z * (1 + k * (3 - f)),
            r,
        )

    def burning(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        ax, ay, az, _ = gravity(x, p, xp)
        t = p.thrust / x.m
        return x.vx, x.vy, x.vz, ax + t * u.a, ay + t * u.b, az + t * u.c, -p.thrust / p.exhaust

    def falling(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        ax, ay, az, r = gravity(x, p, xp)
        v = xp.sqrt(x.vx**2 + x.vy**2 + x.vz**2)
        drag = 0.5 * p.density * xp.exp(-(r - p.radius) / p.height) * p.area / x.m * v
        return x.vx, x.vy, x.vz, ax - drag * x.vx, ay - drag * x.vy, az - drag * x.vz, 0.0 * p.thrust / p.exhaust

    def gate(x: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        r, v = xp.sqrt(x.x**2 + x.y**2 + x.z**2), xp.sqrt(x.vx**2 + x.vy**2 + x.vz**2)
        return r - p.gate, v - p.speed, (x.x * x.vx + x.y * x.vy + x.z * x.vz) / (r * v) - xp.sin(p.angle)

    def way(share: float) -> Any:
        turn, back = math.radians(275.0) * share, -TURNS * 4400.0 * share
        out = ahead * math.cos(turn) + np.cross(normal, ahead) * math.sin(turn)
        spin = np.array([[math.cos(back), -math.sin(back), 0], [math.sin(back), math.cos(back), 0], [0, 0, 1]])
        out, on = spin @ out, spin @ np.cross(normal, out)
        mass = 1 - 0.3 * share
        return lambda p, xp: (
            *((p.gate + (1 - share) * (p.orbit - p.gate)) * float(c) for c in out),
            *(p.speed * float(c) for c in on),
            mass * p.m0,
        )

    states = (*_variables(x="m", y="m", z="m", vx="m/s", vy="m/s", vz="m/s"), Variable(name="m", unit="kg", lower=50.0))
    legs = [
        pl.Phase(
            name=f"leg{j}",
            states=states,
            controls=(pl.UnitVectorControl(names=("a", "b", "c")),),
            dynamics=burning,
            duration="leg",
            end_guess=way(j / count),
            end=pl.Conditions.of(
                gate if j == count else None,
                _variables(shell="m", entry_speed="m/s", entry_angle="1") if j == count else (),
            ),
            path=pl.Conditions(lambda x, u, p, xp: ((x.x * x.x + x.y * x.y + x.z * x.z) / p.gate**2 - 1,), above="1"),
        )
        for j in range(1, count + 1)
    ]
    on = np.cross(normal, ahead)
    fall = pl.Phase(
        name="entry", states=states, dynamics=falling, duration="fall",
        end=pl.Conditions(lambda x, p, xp: tuple(
            a - (p.radius + p.site) * float(c) for a, c in zip((x.x, x.y, x.z), site, strict=True)
        ), site_x="m", site_y="m", site_z="m"),
        end_guess=lambda p, xp: (
            *((p.radius + p.site) * float(c) for c in site), *(0.1 * p.speed * float(c) for c in on), 0.7 * p.m0,
        ),
    )  # fmt: skip
    at = {f"{n}0": (float(v), "m") for n, v in zip("xyz", start, strict=True)}
    going = {f"v{n}0": (float(v), "m/s") for n, v in zip("xyz", velocity, strict=True)}
    return pl.Problem(
        name="deorbit",
        phases=(*legs, fall),
        start=lambda p, xp: (p.x0, p.y0, p.z0, p.vx0, p.vy0, p.vz0, p.m0),
        links=(lambda x, p, xp: tuple(x),) * count,
        given=_given(
            mu=(MU, "m^3/s^2"),
            radius=(RADIUS, "m"),
            turns=(TURNS, "rad/s"),
            j2=(1.08263e-3, "1"),
            thrust=(100.0, "N"),
            exhaust=(3000.0, "m/s"),
            m0=(500.0, "kg"),
            density=(1.225, "kg/m^3"),
            height=(7200.0, "m"),
            area=(0.6, "m^2"),
            site=(10e3, "m"),
            gate=(RADIUS + 120e3, "m"),
            orbit=(6678.14e3, "m"),
            speed=(7500.0, "m/s"),
            angle=(math.radians(-6.0), "rad"),
            **at,
            **going,
        ),
        free=(
            pl.FreeParameter(name="leg", unit="s", lower=500.0 / count, upper=6000.0 / count, guess=4300.0 / count),
            pl.FreeParameter(name="fall", unit="s", lower=20.0, upper=900.0, guess=200.0),
        ),
        objective=lambda x, p, xp: count * p.leg + p.fall,
        objective_unit="s",
        scales=pl.Scales(length=RADIUS, time=math.sqrt(RADIUS**3 / MU), mass=500.0),
    )


def _unit(latitude: float, longitude: float) -> Any:
    return np.array([
        math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude)
    ])  # fmt: skip


def _orbit(latitude: float, longitude: float) -> tuple[Any, Any]:
    """Position and velocity in turning axes on a circular orbit of 50 degrees inclination, going south."""
    inclination, radius = math.radians(50.0), 6678.14e3
    u = math.pi - math.asin(math.sin(latitude) / math.sin(inclination))
    node = longitude - math.atan2(math.cos(inclination) * math.sin(u), math.cos(u))
    at = _unit(latitude, longitude)
    normal = np.array([math.sin(node) * math.sin(inclination), -math.cos(node) * math.sin(inclination),
                       math.cos(inclination)])  # fmt: skip
    position = at * radius
    return position, np.cross(normal, at) * math.sqrt(MU / radius) - np.cross([0.0, 0.0, TURNS], position)
