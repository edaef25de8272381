"""A problem that perilune does not know: a hop over 2 km of flat Moon with the least propellant, by both methods."""

import perilune as pl


def variables(**units):
    """Named components with their units."""
    return tuple(pl.Variable(name=name, unit=unit) for name, unit in units.items())


hop = pl.Phase(
    name="hop",
    states=variables(x="m", y="m", vx="m/s", vy="m/s", m="kg"),
    controls=(
        pl.UnitVectorControl(names=("along", "up")),
        pl.ScalarControl(name="thrust", unit="N", lower=0.0, upper=4000.0),
    ),
    dynamics=lambda x, u, p, xp: (
        x.vx, x.vy, u.thrust / x.m * u.along, u.thrust / x.m * u.up - p.g, -u.thrust / p.exhaust_speed,
    ),
    duration="flight_time",
    end=pl.Conditions(
        lambda x, p, xp: (x.x - p.distance, x.y, x.vx, x.vy), place="m", ground="m", speed_along="m/s", speed_up="m/s"
    ),
    end_guess=lambda p, xp: (p.distance, 0.0, 0.0, 0.0, 0.9 * p.mass),
)  # fmt: skip
problem = pl.Problem(
    name="lunar_hop",
    phases=(hop,),
    start=lambda p, xp: (0.0, 0.0, 0.0, 0.0, p.mass),
    given={
        "g": pl.Parameter(value=1.62, unit="m/s^2"),
        "distance": pl.Parameter(value=2000.0, unit="m"),
        "mass": pl.Parameter(value=1000.0, unit="kg"),
        "exhaust_speed": pl.Parameter(value=3000.0, unit="m/s"),
    },
    free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.0, upper=300.0, guess=60.0),),
    objective=lambda x, p, xp: -x.m,
    objective_unit="kg",
    scales=pl.Scales(length=1000.0, time=30.0, mass=1000.0),
)

exact = pl.solve(problem)
direct = pl.solve(problem, pl.Pseudospectral(polish=False), verify=0)
for solution in (exact, direct):
    print(f"{solution.method:14} {1000 + solution.objective:.6f} kg in {solution.free['flight_time']:.4f} s")
print(exact.outcome.name, exact.verification.level)
